// The minimum of a pose graph, and the marginal covariances there.
#include <Eigen/LU>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/motion.hpp"

using namespace trigpoint;

namespace {

constexpr int MOST_STEPS = 8;
// The iteration ends at a step that is smaller than this in every unknown (m, rad), or that
// promises a smaller gain in the score.
constexpr double SMALL_STEP = 1e-5, SMALL_GAIN = 1e-3;

using Index = Eigen::Index;
using Sparse = Eigen::SparseMatrix<double>;

// The information matrix of a graph, factorised: unknowns are scaled first, so that those that are
// known exactly and those that are hardly known have equations of comparable magnitude.
struct Factor {
    Eigen::SimplicialLDLT<Sparse> parts;
    Eigen::VectorXd scale;

    bool is_positive() const {
        return parts.info() == Eigen::Success && (parts.vectorD().array() > 0).all();
    }
    double log_determinant() const {
        return parts.vectorD().array().log().sum() - 2 * scale.array().log().sum();
    }
};

// The most rows of a term, of a pose and a camera's own unknowns, and its most unknowns, of two.
constexpr int MOST_OWN = 14, MOST_ROWS = 6 + MOST_OWN, MOST_COLUMNS = 12 + MOST_OWN;
using Small = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, MOST_COLUMNS,
                            MOST_COLUMNS>;

// One term of the cost: residualᵀ information residual, its derivatives by the unknowns in `rows`
// (-1: held).
struct Term {
    std::vector<Index> rows;
    Small jacobian;
    Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, MOST_ROWS> residual;
    Small information;
};

// Normal equations of terms that always come in one order: where each entry goes is found once.
class Normal {
public:
    double cost = 0;
    Eigen::VectorXd gradient;
    Sparse matrix;  // the lower triangle

    explicit Normal(Index size) : gradient(size), matrix(size, size) {}

    void begin() {
        cost = 0;
        gradient.setZero();
        if (is_planned_) std::fill_n(matrix.valuePtr(), matrix.nonZeros(), 0.0);
        next_ = 0;
    }
    // Products are taken entry by entry: what lies ready for large matrices costs more than these.
    void add(const Term& term) {
        std::array<Index, MOST_COLUMNS> rows;
        Small jacobian(term.jacobian.rows(), term.jacobian.cols());
        Index free = 0;  // a robot in the plane leaves half of the directions held
        for (std::size_t i = 0; i < term.rows.size(); ++i) {
            if (term.rows[i] < 0) continue;
            jacobian.col(free) = term.jacobian.col(static_cast<Index>(i));
            rows[static_cast<std::size_t>(free++)] = term.rows[i];
        }
        const Small weighted = jacobian.leftCols(free).transpose().lazyProduct(term.information);
        cost += term.residual.dot(term.information.lazyProduct(term.residual));
        for (Index i = 0; i < free; ++i) {
            const Index row = rows[static_cast<std::size_t>(i)];
            gradient[row] += weighted.row(i).dot(term.residual);
            for (Index j = 0; j < free; ++j) {
                const Index column = rows[static_cast<std::size_t>(j)];
                if (column <= row) put(row, column, weighted.row(i).dot(jacobian.col(j)));
            }
        }
    }
    void end() {
        if (is_planned_) return;
        matrix.setFromTriplets(entries_.begin(), entries_.end());
        for (const Entry& entry : entries_) {
            const auto* first = matrix.innerIndexPtr() + matrix.outerIndexPtr()[entry.col()];
            const auto* last = matrix.innerIndexPtr() + matrix.outerIndexPtr()[entry.col() + 1];
            slots_.push_back(std::lower_bound(first, last, entry.row()) - matrix.innerIndexPtr());
        }
        is_planned_ = true;
    }

private:
    using Entry = Eigen::Triplet<double, int>;
    std::vector<Entry> entries_;
    std::vector<Index> slots_;
    std::size_t next_ = 0;
    bool is_planned_ = false;

    void put(Index row, Index column, double value) {
        if (is_planned_)
            matrix.valuePtr()[slots_[next_++]] += value;
        else
            entries_.emplace_back(static_cast<int>(row), static_cast<int>(column), value);
    }
};

using Places = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 12, Eigen::RowMajor>>;

// What `tp_graph_minimum` is given, in its order.
enum Given {
    FACTOR,
    POSES,
    POSE_ROWS,
    VALUES,
    BOUNDS,
    VALUE_ROWS,
    PRIOR_OF,
    PRIOR_AT,
    PRIOR_INFORMATION,
    VALUE_MEAN,
    VALUE_INFORMATION,
    STEP_ENDS,
    STEP_MOTION,
    STEP_INFORMATION,
    STEP_BY_SCALE,
    STEP_ABOUT,
    TIE_ENDS,
    TIE_MOTION,
    TIE_INFORMATION,
    TIE_VALUES,
    SCORE
};

class Graph {
public:
    explicit Graph(const Argument* given) : given_(given), poses_(given[POSES].array.rows<12>()) {
        size_ = 0;
        const Index most = 6 * poses() + values();
        for (int which : {POSE_ROWS, VALUE_ROWS}) {
            const Array& rows = array(which);
            const Index count = rows.shape[0] * std::max<Index>(rows.shape[1], 1);
            for (Index i = 0; i < count; ++i) {
                if (integers(which)[i] < (which == POSE_ROWS ? -1 : 0) ||
                    integers(which)[i] >= most)
                    throw std::invalid_argument("a row that is none");
                size_ = std::max<Index>(size_, integers(which)[i] + 1);
            }
        }
        checked(PRIOR_OF, 1, {poses()});
        checked(STEP_ENDS, 4, {poses(), poses(), std::max<Index>(values() - 1, 0), 2});
        checked(TIE_ENDS, 4, {poses(), poses(), values(), own() + 1});
        if (array(TIE_INFORMATION).shape[1] != 6 + own() || own() > MOST_OWN)
            throw std::invalid_argument("information of others");
        for (Index k = 0; k < array(TIE_ENDS).shape[0]; ++k) {
            const std::int64_t* ends = integers(TIE_ENDS) + 4 * k;
            if (ends[3] < 0 || (ends[3] > 0 && (ends[2] < 0 || ends[2] + ends[3] > values())))
                throw std::invalid_argument("a tie to values that are none");
        }
    }

    Index size() const { return size_; }

    void linearise(Normal& normal) const {
        normal.begin();
        for (Index i = 0; i < array(PRIOR_OF).shape[0]; ++i) normal.add(prior(i));
        for (Index i = 0; i < array(STEP_ENDS).shape[0]; ++i) normal.add(step(i));
        for (Index i = 0; i < array(TIE_ENDS).shape[0]; ++i) normal.add(tie(i));
        for (Index i = 0; i < values(); ++i) normal.add(value_prior(i));
        normal.end();
    }

    void move(const Eigen::VectorXd& by) {
        for (Index i = 0; i < poses(); ++i) {
            Vector6d shift;
            for (int k = 0; k < 6; ++k) {
                const Index row = integers(POSE_ROWS)[6 * i + k];
                shift[k] = row < 0 ? 0 : by[row];
            }
            put_pose(pose(i).disturbed(shift), &poses_(i, 0));
        }
        for (Index i = 0; i < values(); ++i) {
            const double limit = numbers(BOUNDS)[i];
            double& value = numbers(VALUES)[i];
            value = std::max(-limit, std::min(limit, value + by[integers(VALUE_ROWS)[i]]));
        }
    }

private:
    const Argument* given_;
    Places poses_;
    Index size_;

    const Array& array(int which) const { return given_[which].array; }
    double* numbers(int which) const { return array(which).as<double>(); }
    const std::int64_t* integers(int which) const { return array(which).as<std::int64_t>(); }
    Index poses() const { return poses_.rows(); }
    Index values() const { return array(VALUES).shape[0]; }
    Index own() const { return array(TIE_VALUES).shape[1]; }
    Pose pose(Index i) const { return pose_at(&poses_(i, 0)); }

    // Refuses integers beyond these limits; of several, only from the third on may they be -1.
    void checked(int which, int width, std::vector<Index> limits) const {
        for (Index i = 0; i < array(which).shape[0]; ++i)
            for (int k = 0; k < width; ++k) {
                const std::int64_t number = integers(which)[width * i + k];
                const Index least = width == 1 || k < 2 ? 0 : -1;
                if (number < least || number >= limits[static_cast<std::size_t>(k)])
                    throw std::invalid_argument("a term of a pose or value that is none");
            }
    }
    void free(std::vector<Index>& rows, Index pose) const {
        for (int k = 0; k < 6; ++k) rows.push_back(integers(POSE_ROWS)[6 * pose + k]);
    }

    Term prior(Index i) const {
        Term term;
        const Index which = integers(PRIOR_OF)[i];
        free(term.rows, which);
        term.jacobian = Matrix6d::Identity();
        term.residual = pose(which).difference(pose_at(numbers(PRIOR_AT) + 12 * i));
        term.information = Eigen::Map<const RowMajor>(numbers(PRIOR_INFORMATION) + 36 * i, 6, 6);
        return term;
    }

    Term value_prior(Index i) const {
        Term term;
        term.rows = {integers(VALUE_ROWS)[i]};
        term.jacobian = Small::Identity(1, 1);
        term.residual.setConstant(1, numbers(VALUES)[i] - numbers(VALUE_MEAN)[i]);
        term.information = Small::Constant(1, 1, numbers(VALUE_INFORMATION)[i]);
        return term;
    }

    // The term of the motion from one pose to another, `expected` at their values.
    Term between(Index first, Index second, const Pose& expected, Index more) const {
        Term term;
        term.rows.reserve(MOST_COLUMNS);
        free(term.rows, first);
        free(term.rows, second);
        const Pose a = pose(first), b = pose(second);
        Matrix6d by_a, by_b;
        relative_jacobians(a, b, by_a, by_b);
        term.jacobian = Small::Zero(6 + more, 12 + more);
        term.jacobian.topLeftCorner<6, 6>() = by_a;
        term.jacobian.block<6, 6>(0, 6) = by_b;
        term.residual.setZero(6 + more);
        term.residual.head<6>() = a.inverse().times(b).difference(expected);
        return term;
    }

    Term step(Index i) const {
        const std::int64_t* ends = integers(STEP_ENDS) + 4 * i;
        const Index scale = ends[2];
        Pose expected = pose_at(numbers(STEP_MOTION) + 12 * i);
        Eigen::Matrix<double, 6, 2> by_scale;
        by_scale.setZero();
        if (scale >= 0) {
            by_scale = Eigen::Map<const Eigen::Matrix<double, 6, 2, Eigen::RowMajor>>(
                numbers(STEP_BY_SCALE) + 12 * i);
            const Eigen::Vector2d about(numbers(STEP_ABOUT)[2 * i], numbers(STEP_ABOUT)[2 * i + 1]);
            const Eigen::Vector2d now(numbers(VALUES)[scale], numbers(VALUES)[scale + 1]);
            expected = expected.disturbed(by_scale * (now - about));
        }
        Term term = between(ends[0], ends[1], expected, 0);
        term.information = Eigen::Map<const RowMajor>(numbers(STEP_INFORMATION) + 36 * i, 6, 6);
        const bool is_anywhere = ends[3] > 0;
        if (is_anywhere) term.residual.setZero();
        if (scale >= 0) {
            term.rows.push_back(integers(VALUE_ROWS)[scale]);
            term.rows.push_back(integers(VALUE_ROWS)[scale + 1]);
            term.jacobian.conservativeResize(6, 14);
            term.jacobian.rightCols<2>() = -by_scale;
            if (is_anywhere) term.jacobian.rightCols<2>().setZero();
        }
        return term;
    }

    Term tie(Index i) const {
        const std::int64_t* ends = integers(TIE_ENDS) + 4 * i;
        const Index count = ends[3], whole = array(TIE_INFORMATION).shape[1];
        Term term = between(ends[0], ends[1], pose_at(numbers(TIE_MOTION) + 12 * i), count);
        term.information =
            Eigen::Map<const RowMajor>(numbers(TIE_INFORMATION) + whole * whole * i, whole, whole)
                .topLeftCorner(6 + count, 6 + count);
        for (Index k = 0; k < count; ++k) {
            term.rows.push_back(integers(VALUE_ROWS)[ends[2] + k]);
            term.jacobian(6 + k, 12 + k) = 1;
            term.residual[6 + k] =
                numbers(VALUES)[ends[2] + k] - numbers(TIE_VALUES)[own() * i + k];
        }
        return term;
    }
};

// Whether every unknown has an equation; the factor is then of these equations, which are those of
// one graph: the order of elimination `is_known` from its first ones.
bool factorised(const Normal& normal, Factor& factor, bool is_known) {
    const Eigen::VectorXd diagonal = normal.matrix.diagonal();
    if (!(diagonal.array() > 0).all() || !diagonal.allFinite()) return false;
    factor.scale = diagonal.array().rsqrt();
    Sparse scaled = factor.scale.asDiagonal() * normal.matrix * factor.scale.asDiagonal();
    if (!is_known) factor.parts.analyzePattern(scaled);
    factor.parts.factorize(scaled);
    return factor.parts.info() == Eigen::Success;
}

}  // namespace

TRIGPOINT_OBJECT(tp_factor, Factor)

// (factor, poses (N, 12), their rows (N, 6), values (v,), their bounds (v,), their rows (v,),
// [absolute] pose (p,), expected (p, 12), information (p, 6, 6), values' mean (v,) and
// information (v,), [steps] ends (m, 4), motion (m, 12), information (m, 6, 6), by scales (m, 6,
// 2), about (m, 2), [ties] ends (k, 4), motion (k, 12), information (k, q, q), values (k, o), cost
// and ln|information| (2,)): 1 where the minimum is determined; see `minimum.placed`.
TRIGPOINT_KERNEL(tp_graph_minimum) {
    auto& factor = *static_cast<Factor*>(arguments[FACTOR].object);
    Graph graph(arguments);
    Normal normal(graph.size());
    double* score = arguments[SCORE].array.as<double>();
    bool is_settled = false;
    score[0] = score[1] = 0;
    for (int round = 0; round < MOST_STEPS && !is_settled; ++round) {
        graph.linearise(normal);
        if (!factorised(normal, factor, round > 0)) return 0;
        const Eigen::VectorXd step = -factor.scale.cwiseProduct(
            factor.parts.solve(factor.scale.cwiseProduct(normal.gradient)));
        if (!step.allFinite()) return 0;
        const double gain = -step.dot(normal.gradient);
        graph.move(step);
        is_settled =
            step.size() == 0 || step.cwiseAbs().maxCoeff() < SMALL_STEP || gain < SMALL_GAIN;
        score[0] = normal.cost - gain;
    }
    if (!is_settled) {
        graph.linearise(normal);
        if (!factorised(normal, factor, true)) return 0;
        score[0] = normal.cost;
    }
    score[1] = factor.log_determinant();
    return factor.is_positive() && std::isfinite(score[0]) && std::isfinite(score[1]);
}

namespace {

// Where the modes (k) of a visit, or a place of the graph, put a camera: relative to a pose of the
// graph, whose rows (6,) are -1 where it is held, with a covariance in that one's axes.
class Seen {
public:
    // Pose (1, 12), rows (6,), the camera from there (k, 12), covariances (k, 6, 6), evidence (k,).
    static constexpr int ARGUMENTS = 5;

    Seen(const Argument* given, Index size) : given_(given), base_(pose_at(numbers(0))) {
        for (int axis = 0; axis < 6; ++axis) {
            const std::int64_t row = given[1].array.as<std::int64_t>()[axis];
            if (row < -1 || row >= size) throw std::invalid_argument("a row that is none");
            if (row < 0) continue;
            rows.push_back(row);
            axes_.push_back(axis);
        }
    }

    std::vector<Index> rows;

    Index modes() const { return given_[4].array.shape[0]; }
    double evidence(Index mode) const { return numbers(4)[mode]; }
    Pose pose(Index mode, const Pose& base) const {
        return base.times(pose_at(numbers(2) + 12 * mode));
    }
    Matrix6d own(Index mode, const Pose& base) const {
        Matrix6d turn = Matrix6d::Zero();
        turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = base.rotation;
        return turn * Eigen::Map<const Matrix6d>(numbers(3) + 36 * mode) * turn.transpose();
    }
    // Its derivative by the unknowns in `rows`: a turn of the base swings what is seen from it.
    AtMost6 by_rows(Index mode, const Pose& base) const {
        Matrix6d lever = Matrix6d::Identity();
        lever.topRightCorner<3, 3>() = -hat(pose(mode, base).translation - base.translation);
        return lever(Eigen::all, axes_);
    }
    // The base where the unknowns in `rows` have changed by this; by how much that turned it.
    Pose moved(const Eigen::Ref<const Eigen::VectorXd>& by) const {
        return base_.disturbed(in_all_axes(by));
    }
    double turned(const Eigen::Ref<const Eigen::VectorXd>& by) const {
        return in_all_axes(by).tail<3>().norm();
    }

private:
    const Argument* given_;
    Pose base_;
    std::vector<Index> axes_;

    double* numbers(int which) const { return given_[which].array.as<double>(); }
    Vector6d in_all_axes(const Eigen::Ref<const Eigen::VectorXd>& by) const {
        Vector6d all = Vector6d::Zero();
        all(axes_) = by;
        return all;
    }
};

// The marginal covariance of the unknowns in these rows, each of them one.
RowMajor covariance_of(const Factor& factor, const std::vector<Index>& rows) {
    const auto count = static_cast<Index>(rows.size());
    Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(factor.scale.size(), count);
    for (Index i = 0; i < count; ++i) {
        const Index row = rows[static_cast<std::size_t>(i)];
        unit(row, i) = factor.scale[row];
    }
    if (factor.scale.size() == 0 || !factor.is_positive())
        throw std::invalid_argument("nothing is factorised");
    const Eigen::MatrixXd solved = factor.scale.asDiagonal() * factor.parts.solve(unit);
    const Eigen::MatrixXd mine = solved(rows, Eigen::all);
    return 0.5 * (mine + mine.transpose());
}

}  // namespace

// (factor, rows (k,), covariance (k, k)): 0; see `factor.Factor.covariance`.
TRIGPOINT_KERNEL(tp_factor_covariance) {
    const auto& factor = *static_cast<Factor*>(arguments[0].object);
    const Index count = arguments[1].array.shape[0], size = factor.scale.size();
    const std::int64_t* given = arguments[1].array.as<std::int64_t>();
    const std::vector<Index> rows(given, given + count);
    for (const Index row : rows)
        if (row < 0 || row >= size) throw std::invalid_argument("a row that is none");
    Eigen::Map<RowMajor>(arguments[2].array.as<double>(), count, count) =
        covariance_of(factor, rows);
    return 0;
}

namespace {

// What a mode says is turned with its base, and swings by its lever: its agreement with another is
// judged where the two together put the bases, unless they turn these by less than this (rad).
constexpr double SMALL_TURN = 0.01;
constexpr int MOST_TURNS = 8;

// -2 ln of the likelihood that two modes show one place, by the joint covariance `shared` of the
// unknowns of both bases and that of the places' difference, `beside`.
double disagreement(const Seen& first, Index k, const Seen& second, Index m, const RowMajor& shared,
                    const Matrix6d& beside) {
    const auto count = static_cast<Index>(first.rows.size()), others = shared.cols() - count;
    Eigen::Matrix<double, 6, Eigen::Dynamic> by(6, shared.cols());
    Eigen::VectorXd moved = Eigen::VectorXd::Zero(shared.cols());
    double cost = 0, unmoved = 0;
    for (int round = 0; round < MOST_TURNS; ++round) {
        const Pose old = first.moved(moved.head(count)), now = second.moved(moved.tail(others));
        by.leftCols(count) = -first.by_rows(k, old);
        by.rightCols(others) = second.by_rows(m, now);
        const Matrix6d spread =
            by * shared * by.transpose() + first.own(k, old) + beside + second.own(m, now);
        const Vector6d error = second.pose(m, now).difference(first.pose(k, old)) - by * moved;
        const Eigen::PartialPivLU<Matrix6d> parts(spread);
        const Vector6d weighted = parts.solve(error);
        cost = error.dot(weighted) + parts.matrixLU().diagonal().array().abs().log().sum();
        if (round == 0) unmoved = cost;
        const Eigen::VectorXd further = -shared * by.transpose() * weighted - moved;
        if (!std::isfinite(cost) || !further.allFinite()) break;
        if (first.turned(further.head(count)) < SMALL_TURN &&
            second.turned(further.tail(others)) < SMALL_TURN)
            return cost;
        moved += further;
    }
    return unmoved;  // the two put the bases nowhere together
}

}  // namespace

// (factor, two of `Seen`, the covariance (6, 6) of the difference of their places, costs (k, m)):
// 0; see `agreement.agreement`.
TRIGPOINT_KERNEL(tp_agreement) {
    const auto& factor = *static_cast<Factor*>(arguments[0].object);
    const Seen first(arguments + 1, factor.scale.size()),
        second(arguments + 1 + Seen::ARGUMENTS, factor.scale.size());
    const Argument* rest = arguments + 1 + 2 * Seen::ARGUMENTS;
    const Eigen::Map<const Matrix6d> beside(rest[0].array.as<double>());
    std::vector<Index> rows = first.rows;
    rows.insert(rows.end(), second.rows.begin(), second.rows.end());
    const RowMajor shared = covariance_of(factor, rows);
    for (Index k = 0; k < first.modes(); ++k)
        for (Index m = 0; m < second.modes(); ++m) {
            const double cost = disagreement(first, k, second, m, shared, beside);
            if (!std::isfinite(cost)) throw std::invalid_argument("poses that nothing determines");
            rest[1].array.as<double>()[second.modes() * k + m] =
                cost + first.evidence(k) + second.evidence(m);
        }
    return 0;
}
