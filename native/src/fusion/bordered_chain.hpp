// Normal equations of a chain of nodes and of a border: what all equations may share.
//
// The chain is eliminated block by block, and what is asked of the inverse follows backwards from
// the factor (Takahashi, Fagan and Chin, 1973).
#pragma once

#include <Eigen/Cholesky>
#include <vector>

namespace trigpoint {

// An unknown that is held, or none.
constexpr Eigen::Index HELD = -1;

// Share of an unknown's information that is added to it: one that nothing but nearly free odometry
// determines is at the limit of double precision.
constexpr double ROUNDING = 1e-12;

// Equations of R rows, whitened: their derivatives by the nodes `earlier` and `later` (D each), by
// what all may share, by the two slopes of the floor at a place, and last their right side.
template <int R, int D>
struct Equation {
    using Square = Eigen::Matrix<double, R, R>;
    Eigen::Index earlier = HELD, later = HELD, place = HELD;
    Eigen::Matrix<double, R, Eigen::Dynamic> columns;
    Eigen::LLT<Square> root;

    void whiten(const Square& covariance) {
        root.compute(covariance);
        root.matrixL().solveInPlace(columns);
    }
    double log_determinant() const { return 2 * root.matrixLLT().diagonal().array().log().sum(); }

    // The derivatives of the misfit by the entries of the covariance, where `known` is the
    // covariance of what the unknowns predict, and `left` the residual.
    Square by_covariance(const Square& known, const Eigen::Matrix<double, R, 1>& left) const {
        const Square half =
            root.matrixU().solve(Square::Identity() - known - left * left.transpose());
        return root.matrixU().solve(half.transpose());
    }
};

// The normal equations of a visit: D unknowns a node, and those of the border.
template <int D>
class BorderedChain {
    using Block = Eigen::Matrix<double, D, D>;

public:
    BorderedChain(Eigen::Index nodes, Eigen::Index others, Eigen::Index places)
        : others_(others),
          diagonal_(Eigen::MatrixXd::Zero(D, D * nodes)),
          lower_(Eigen::MatrixXd::Zero(D, D * nodes)),
          cross_(Eigen::MatrixXd::Zero(others + 2 * places, D * nodes)),
          border_(Eigen::MatrixXd::Zero(others + 2 * places, others + 2 * places)),
          chain_(Eigen::VectorXd::Zero(D * nodes)),
          shared_(Eigen::VectorXd::Zero(others + 2 * places)),
          roots_(nodes) {}

    Eigen::MatrixXd& border() { return border_; }

    template <int R>
    void add(const Equation<R, D>& equation) {
        const Eigen::MatrixXd square = equation.columns.transpose() * equation.columns;
        const Eigen::Index right = square.cols() - 1;
        each_tie(equation,
                 [&](Eigen::Index row, Eigen::Index column, Eigen::Ref<Eigen::MatrixXd> to) {
                     to += square.block(row, column, to.rows(), to.cols());
                 });
        each_part(equation, [&](Eigen::Index row, Eigen::Ref<Eigen::VectorXd> to) {
            to += square.col(right).segment(row, to.size());
        });
    }

    // Solves and inverts in place; whether everything is determined.
    bool solve() {
        const Eigen::Index nodes = static_cast<Eigen::Index>(roots_.size());
        border_.diagonal() *= 1 + ROUNDING;
        for (Eigen::Index j = 0; j < nodes; ++j) {
            Block own = of(diagonal_, j);
            own.diagonal() *= 1 + ROUNDING;
            if (j) {
                const Block before = of(lower_, j - 1);
                own.noalias() -= before * before.transpose();
                of(cross_, j).noalias() -= of(cross_, j - 1) * before.transpose();
                chain(j).noalias() -= before * chain(j - 1);
            }
            if (roots_[j].compute(own).info() != Eigen::Success) return false;
            auto across = of(cross_, j), next = of(lower_, j);
            auto pull = chain(j);
            roots_[j].matrixU().template solveInPlace<Eigen::OnTheRight>(across);
            roots_[j].matrixU().template solveInPlace<Eigen::OnTheRight>(next);
            roots_[j].matrixL().solveInPlace(pull);
        }
        border_.template selfadjointView<Eigen::Lower>().rankUpdate(cross_, -1.0);
        shared_.noalias() -= cross_ * chain_;
        border_root_.compute(border_);
        if (border_root_.info() != Eigen::Success) return false;
        border_root_.solveInPlace(shared_);
        border_.setIdentity();
        border_root_.solveInPlace(border_);
        for (Eigen::Index j = nodes - 1; j >= 0; --j) {
            Block own = Block::Identity();
            auto across = of(cross_, j);
            auto pull = chain(j);
            pull.noalias() -= across.transpose() * shared_;
            if (j + 1 < nodes) {
                const Block after = of(lower_, j), next = of(diagonal_, j + 1) * after;
                pull.noalias() -= after.transpose() * chain(j + 1);
                across.noalias() -= of(cross_, j + 1) * after;
                own.noalias() += after.transpose() * next;
                of(lower_, j) = -roots_[j].matrixU().solve(next.transpose()).transpose();
            }
            roots_[j].matrixU().solveInPlace(pull);
            roots_[j].matrixL().template solveInPlace<Eigen::OnTheRight>(across);
            own = roots_[j].matrixU().solve(own).transpose().eval();
            of(diagonal_, j) = roots_[j].matrixU().solve(own);
        }
        // Until here the chain's inverse with the border held; `cross_`: times what ties them.
        const Eigen::MatrixXd to_border = border_ * cross_;
        for (Eigen::Index j = 0; j < nodes; ++j) {
            of(diagonal_, j).noalias() += of(cross_, j).transpose() * of(to_border, j);
            if (j + 1 < nodes)
                of(lower_, j).noalias() += of(cross_, j + 1).transpose() * of(to_border, j);
        }
        cross_ = -to_border;
        return true;
    }
    double log_determinant() const {
        double sum = border_root_.matrixLLT().diagonal().array().log().sum();
        for (const auto& root : roots_) sum += root.matrixLLT().diagonal().array().log().sum();
        return 2 * sum;
    }
    const Eigen::VectorXd& border_solution() const { return shared_; }
    const Eigen::MatrixXd& border_covariance() const { return border_; }

    // The covariance of what the unknowns predict of an equation, and its residual.
    template <int R>
    Eigen::Matrix<double, R, R> known(const Equation<R, D>& equation,
                                      Eigen::Matrix<double, R, 1>& left) {
        const Eigen::Index unknowns = equation.columns.cols() - 1;
        Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(unknowns, unknowns);
        Eigen::VectorXd solution = Eigen::VectorXd::Zero(unknowns);
        each_tie(equation,
                 [&](Eigen::Index row, Eigen::Index column, Eigen::Ref<Eigen::MatrixXd> from) {
                     covariance.block(row, column, from.rows(), from.cols()) = from;
                     covariance.block(column, row, from.cols(), from.rows()) = from.transpose();
                 });
        each_part(equation, [&](Eigen::Index row, Eigen::Ref<Eigen::VectorXd> from) {
            solution.segment(row, from.size()) = from;
        });
        const auto by = equation.columns.leftCols(unknowns);
        left = equation.columns.col(unknowns) - by * solution;
        return by * covariance * by.transpose();
    }

private:
    template <class Any>
    static auto of(Any& blocks, Eigen::Index node) {
        return blocks.template middleCols<D>(D * node);
    }
    auto chain(Eigen::Index node) { return chain_.segment<D>(D * node); }

    // Calls with each block of the matrix, of those not above the diagonal, that ties unknowns of
    // an equation, and where these are among its columns.
    template <int R, class Work>
    void each_tie(const Equation<R, D>& equation, Work&& work) {
        const Eigen::Index q = others_, at = q + 2 * equation.place, slopes = 2 * D + q;
        const bool is_tilted = equation.place != HELD;
        work(2 * D, 2 * D, border_.topLeftCorner(q, q));
        if (is_tilted) {
            work(slopes, 2 * D, border_.block(at, 0, 2, q));
            work(slopes, slopes, border_.block(at, at, 2, 2));
        }
        const Eigen::Index nodes[] = {equation.earlier, equation.later};
        for (Eigen::Index i = 0; i < 2; ++i) {
            if (nodes[i] == HELD) continue;
            work(D * i, D * i, of(diagonal_, nodes[i]));
            work(2 * D, D * i, of(cross_, nodes[i]).topRows(q));
            if (is_tilted) work(slopes, D * i, of(cross_, nodes[i]).middleRows(at, 2));
        }
        if (equation.earlier != HELD) work(D, 0, of(lower_, equation.earlier));
    }
    // The same with each part of the right side, or the solution.
    template <int R, class Work>
    void each_part(const Equation<R, D>& equation, Work&& work) {
        if (equation.earlier != HELD) work(0, chain(equation.earlier));
        if (equation.later != HELD) work(D, chain(equation.later));
        work(2 * D, shared_.head(others_));
        if (equation.place != HELD)
            work(2 * D + others_, shared_.segment(others_ + 2 * equation.place, 2));
    }

    Eigen::Index others_;
    // Blocks between a node and itself, between the next node and it, and between the border and
    // it: those of the normal equations, then those of a factor, and at last the covariance's.
    Eigen::MatrixXd diagonal_, lower_, cross_, border_;
    Eigen::VectorXd chain_, shared_;  // the right side, and then the solution
    std::vector<Eigen::LLT<Block>> roots_;
    Eigen::LLT<Eigen::MatrixXd> border_root_;
};

}  // namespace trigpoint
