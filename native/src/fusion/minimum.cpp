// By Levenberg and Marquardt's damping.
#include "fusion/minimum.hpp"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "border.hpp"

using namespace trigpoint;

namespace {

// Damping, relative to the diagonal, after a failed step. The bending of a long chain is so weakly
// determined beside its nodes that even the least damping suppresses it: after successful steps
// there is soon none.
constexpr double DAMPING_LEAST = 1e-6, DAMPING_NONE = 1e-9, DAMPING_END = 1e8;
// An undamped step that fails although it promises less than so many times what ends the search,
// and less than a tenth of a sigma, is as good.
constexpr double UNTOLD = 100, LEAST_TOLD = 0.01;
constexpr std::int64_t MOST_EVER = 10'000;

// The dense part after the chains are eliminated.
class Reduced {
public:
    Eigen::MatrixXd information;
    Eigen::VectorXd gradient;

    explicit Reduced(const Equations& equations)
        : chains_(equations.chains.begin(), equations.chains.end()) {}

    // False where a chain is not determined.
    bool set(const Equations& equations, double damping) {
        information = equations.dense;
        gradient = equations.gradient;
        for (std::size_t c = 0; c < chains_.size(); ++c)
            if (!chains_[c].eliminate(equations.chains[c], damping, information, gradient))
                return false;
        information = (0.5 * (information + information.transpose())).eval();
        return true;
    }

    // The damped step, and the decrease of χ² that it promises; false where it is not determined.
    bool solve(const Equations& equations, double damping, Step& step, double& promised) {
        if (!set(equations, damping)) return false;
        information.diagonal() += damping * information.diagonal().cwiseAbs();
        if (!(information.diagonal().array() > 0).all()) return false;
        scale_ = information.diagonal().array().rsqrt();
        information = (scale_.asDiagonal() * information * scale_.asDiagonal()).eval();
        if (!factorised(information)) return false;
        step.dense = -scale_.cwiseProduct(gradient);
        information.triangularView<Eigen::Lower>().solveInPlace(step.dense);
        information.triangularView<Eigen::Lower>().transpose().solveInPlace(step.dense);
        step.dense = step.dense.cwiseProduct(scale_).eval();
        promised = -equations.gradient.dot(step.dense);
        step.nodes.resize(chains_.size());
        for (std::size_t c = 0; c < chains_.size(); ++c) {
            chains_[c].substitute(step.dense, step.nodes[c]);
            promised -= equations.chains[c].gradient.cwiseProduct(step.nodes[c]).sum();
        }
        return true;
    }

    // The covariance of the dense part, once the undamped step is known.
    Eigen::MatrixXd covariance() const {
        Eigen::MatrixXd root = scale_.asDiagonal();
        information.triangularView<Eigen::Lower>().solveInPlace(root);
        return root.transpose() * root;
    }

    const Elimination& chain(std::size_t which) const { return chains_[which]; }

private:
    std::vector<Elimination> chains_;
    Eigen::VectorXd scale_;
};

// The whole matrix of equations, with nothing eliminated, and the gradient: the inner nodes chain
// by chain, then the dense part.
void write_out(const Equations& equations, Eigen::MatrixXd& matrix, Eigen::VectorXd& gradient) {
    const Index size = equations.gradient.size();
    Index total = size;
    for (const ChainEquations& chain : equations.chains) total += chain.gradient.size();
    const Index dense = total - size;
    matrix = Eigen::MatrixXd::Zero(total, total);
    gradient.resize(total);
    matrix.bottomRightCorner(size, size) = equations.dense;
    gradient.tail(size) = equations.gradient;
    Index row = 0;
    for (const ChainEquations& chain : equations.chains) {
        const Index d = chain.d;
        for (Index n = 0; n < chain.nodes(); ++n, row += d) {
            gradient.segment(row, d) = chain.gradient.col(n);
            matrix.block(row, row, d, d) = chain.diagonal.middleCols(d * n, d);
            if (n + 1 < chain.nodes())
                matrix.block(row + d, row, d, d) = chain.lower.middleCols(d * n, d);
            for (const Range& range : chain.coupled[n])
                matrix.block(dense + range.first, row, range.count, d) +=
                    chain.coupling.middleCols(chain.coupled.begin(n) + range.at, range.count)
                        .transpose();
        }
    }
    matrix.triangularView<Eigen::StrictlyUpper>() = matrix.transpose();
}

}  // namespace

Found trigpoint::minimised(const Argument* given, const Problem& problem, Linearised& linearised) {
    const std::int64_t most = given[MOST_ITERATIONS].whole;
    if (most < 0 || most > MOST_EVER) throw std::invalid_argument("so many iterations are none");
    const double huber = given[HUBER].number;
    State state = problem.state();
    Equations equations = problem.equations(), candidate = equations;
    problem.linearise(state, huber, equations);
    Reduced reduced(equations);
    Step step;
    double damping = 0, promised = 0;
    Found found{0, 0, 0, false};
    while (found.iterations < most && damping < DAMPING_END) {
        ++found.iterations;
        if (!reduced.solve(equations, damping, step, promised)) {
            damping = std::max(damping * 100, DAMPING_LEAST);
            continue;
        }
        found.has_converged = promised < given[TOLERANCE].number;
        if (found.has_converged) break;
        State moved = problem.moved(state, step);
        problem.linearise(moved, huber, candidate);
        if (std::isfinite(candidate.cost) && candidate.cost <= equations.cost) {
            std::swap(state, moved);
            std::swap(equations, candidate);
            damping = damping > DAMPING_NONE ? damping / 30 : 0;
        } else {
            // So near the minimum the cost, of which the equations leave a part out where pictures
            // have jitter, tells steps apart no more.
            found.has_converged = damping <= DAMPING_LEAST && std::isfinite(candidate.cost) &&
                                  promised < std::min(UNTOLD * given[TOLERANCE].number, LEAST_TOLD);
            if (found.has_converged) break;
            damping = std::max(damping * 30, DAMPING_LEAST);
        }
    }
    problem.put(state);
    found.cost = equations.cost;
    // Of the robust cost they would not give the covariance.
    if (std::isfinite(huber))
        problem.linearise(state, std::numeric_limits<double>::infinity(), equations);
    found.plain_cost = equations.cost;
    linearised.log_held = static_cast<double>(problem.held()) * std::log(given[EXACT].number);
    linearised.equations = std::move(equations);
    return found;
}

bool trigpoint::unknowns(const Problem& problem, const Linearised& linearised,
                         const TakeUnknowns& take) {
    const Equations& equations = linearised.equations;
    if (!problem.has(equations)) throw std::invalid_argument("equations of another problem");
    Reduced reduced(equations);
    Step step;
    double promised = 0;
    if (!std::isfinite(equations.cost) || !reduced.solve(equations, 0, step, promised))
        return false;
    const Eigen::MatrixXd dense = reduced.covariance();
    std::vector<std::vector<std::vector<Index>>> at_node;  // by robot; behind the inner ones: last
    for (const ChainEquations& chain : equations.chains)
        at_node.emplace_back(static_cast<std::size_t>(chain.nodes() + 1));
    for (Index p = 0; p < problem.pictures(); ++p) {
        auto& nodes = at_node[static_cast<std::size_t>(problem.robot_of(p))];
        const Index node = problem.inner_node_of(p);
        (node < 0 ? nodes.back() : nodes[static_cast<std::size_t>(node)]).push_back(p);
    }
    for (std::size_t r = 0; r < at_node.size(); ++r) {
        for (const Index p : at_node[r].back()) {
            const std::vector<Index> columns = problem.columns_of(p);
            take(p, step.dense(columns), dense(columns, columns));
        }
        reduced.chain(r).covariances(
            dense, [&](Index node, const Eigen::MatrixXd& own, const Eigen::MatrixXd& across) {
                for (const Index p : at_node[r][static_cast<std::size_t>(node)]) {
                    const std::vector<Index> columns = problem.columns_of(p);
                    const Index d = own.rows(), q = static_cast<Index>(columns.size());
                    Eigen::VectorXd way(d + q);
                    way << step.nodes[r].col(node), step.dense(columns);
                    Eigen::MatrixXd joint(d + q, d + q);
                    joint.topLeftCorner(d, d) = own;
                    joint.topRightCorner(d, q) = across(Eigen::all, columns);
                    joint.bottomLeftCorner(q, d) = joint.topRightCorner(d, q).transpose();
                    joint.bottomRightCorner(q, q) = dense(columns, columns);
                    take(p, way, joint);
                }
            });
    }
    return true;
}

bool System::set(const Linearised& linearised) {
    Eigen::MatrixXd matrix;
    Eigen::VectorXd gradient;
    write_out(linearised.equations, matrix, gradient);
    const Index size = gradient.size();
    const Eigen::VectorXd scale = matrix.diagonal().cwiseMax(1e-300).array().rsqrt();
    matrix = (scale.asDiagonal() * matrix * scale.asDiagonal()).eval();
    if (!std::isfinite(linearised.equations.cost) || !factorised(matrix)) return false;
    Eigen::MatrixXd root = Eigen::MatrixXd::Identity(size, size);
    matrix.triangularView<Eigen::Lower>().solveInPlace(root);
    root = (root * scale.asDiagonal()).eval();
    covariance.noalias() = root.transpose() * root;
    step = -covariance * gradient;
    log_determinant = 2 * (matrix.diagonal().array().log().sum() - scale.array().log().sum()) +
                      linearised.equations.log_determinant - linearised.log_held;
    return true;
}

TRIGPOINT_OBJECT(tp_equations, Linearised)

// (the equations there, a problem and its state, as `Given` says): 1, or 0 where a motion is not
// determined; the state is that of the minimum, and the score and the equations are its.
TRIGPOINT_KERNEL(tp_minimised) {
    double* score = arguments[SCORE].array.as<double>();
    try {
        const Found found = minimised(arguments, Problem(arguments),
                                      *static_cast<Linearised*>(arguments[EQUATIONS].object));
        score[0] = found.cost;
        score[1] = static_cast<double>(found.iterations);
        score[2] = found.has_converged;
        score[3] = found.plain_cost;
    } catch (const Undetermined&) {
        return 0;
    }
    return 1;
}

// (equations, information (q, q) and gradient (q,) of the dense part): 1, or 0 where a chain is not
// determined or the cost is not finite.
TRIGPOINT_KERNEL(tp_reduced) {
    const auto& equations = static_cast<Linearised*>(arguments[0].object)->equations;
    const Index size = equations.gradient.size();
    if (arguments[2].array.shape[0] != size)
        throw std::invalid_argument("other columns are wanted");
    Reduced reduced(equations);
    if (!std::isfinite(equations.cost) || !reduced.set(equations, 0)) return 0;
    Eigen::Map<RowMajor>(arguments[1].array.as<double>(), size, size) = reduced.information;
    Eigen::Map<Eigen::VectorXd>(arguments[2].array.as<double>(), size) = reduced.gradient;
    return 1;
}

// (equations, covariance (u, u) of all unknowns, the step (u,) to the minimum, ln |information|
// (1,)): 1, or 0 where an unknown is not determined or the cost is not finite; see
// `equations.System`.
TRIGPOINT_KERNEL(tp_full_system) {
    System system;
    const auto& found = *static_cast<Linearised*>(arguments[0].object);
    if (!system.set(found)) return 0;
    const Index size = system.step.size();
    if (arguments[2].array.shape[0] != size)
        throw std::invalid_argument("other columns are wanted");
    Eigen::Map<RowMajor>(arguments[1].array.as<double>(), size, size) = system.covariance;
    Eigen::Map<Eigen::VectorXd>(arguments[2].array.as<double>(), size) = system.step;
    arguments[3].array.as<double>()[0] = system.log_determinant;
    return 1;
}
