// What a visit's sightings say of each other: innovations.
#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/pose_fitting.hpp"

using namespace trigpoint;

namespace {

template <int R, int C>
using In =
    Eigen::Map<const Eigen::Matrix<double, R, C, C == 1 ? Eigen::ColMajor : Eigen::RowMajor>>;
using Wide = Eigen::Matrix<double, 6, Eigen::Dynamic>;

// A sighting's share of 1 that is left of its pose's variance, at least.
constexpr double LEAST_LEFT = 1e-6;

// How far a sighting is from where everything else predicts it: νᵀS⁻¹ν and ln|S|.
struct Innovation {
    bool is_determined;
    double chi2, log_spread;
};

// A sighting's derivatives by its pose and by the unknowns (2 k, q), and its residuals; `weight`: 0
// of wild corners; `covariance`: of the unknowns, with the sighting if it `is_used`; `rest`: the χ²
// by which the state may still be off its minimum.
Innovation innovation(const Sighting& seen, const RowMajor& by_state, const Eigen::VectorXd& weight,
                      const Eigen::MatrixXd& covariance, const Vector6d& room, bool is_used,
                      double rest) {
    const Innovation none{false, 0, 0};
    Matrix6d information = room.cwiseInverse().asDiagonal();
    Vector6d pull = Vector6d::Zero();
    Wide across = Wide::Zero(6, by_state.cols());
    for (Eigen::Index k = 0; k < seen.corners(); ++k) {
        if (weight(k) == 0) continue;
        const auto by = seen.by_pose.middleRows<2>(2 * k);
        information.noalias() += by.transpose() * by;
        pull.noalias() += by.transpose() * seen.residual.segment<2>(2 * k);
        across.noalias() += by.transpose() * by_state.middleRows<2>(2 * k);
    }
    if (!information.allFinite()) return none;
    const Eigen::LLT<Matrix6d> known(information);
    if (known.info() != Eigen::Success) return none;
    const Eigen::LLT<Matrix6d> own(known.solve(Matrix6d::Identity()));
    if (own.info() != Eigen::Success) return none;
    Wide whitened = across;  // Eigen solves for no column by an address that is none
    if (across.cols() > 0) whitened = own.matrixL().solve(known.solve(across));
    const Matrix6d predicted = whitened * covariance * whitened.transpose();
    if (!predicted.allFinite()) return none;
    const Eigen::SelfAdjointEigenSolver<Matrix6d> parts(predicted);
    const Vector6d step = own.matrixL().solve(-known.solve(pull));
    const Vector6d pulled =
        ((parts.eigenvectors().transpose() * step).array().abs() - std::sqrt(rest))
            .max(0.0)
            .matrix();
    const auto values = parts.eigenvalues().array();
    Vector6d left;
    if (is_used)
        left = (1 - values).max(LEAST_LEFT).min(1.0).matrix();
    else
        left = (1 + values.max(0.0)).matrix();
    const double own_spread = 2 * own.matrixLLT().diagonal().array().log().sum();
    return {true, (pulled.array().square() / left.array()).sum(),
            own_spread + (is_used ? -1 : 1) * left.array().log().sum()};
}

// The robot's disturbance about its node in one picture, by the corners that are used: through it
// the picture's views constrain each other. Its mean, its covariance given the unknowns, and its
// derivative by these.
struct Stood {
    Vector6d shift;
    Matrix6d own;
    Wide by_state;

    Stood(const ByPoses& by_base, const Eigen::VectorXd& residual, const RowMajor& jacobian,
          const Vector6d& variances) {
        Matrix6d information = by_base.transpose() * by_base;
        information.diagonal() += variances.cwiseInverse();
        own = information.inverse();
        shift = -own * (by_base.transpose() * residual);
        by_state = -own * (by_base.transpose() * jacobian);
    }
    // The covariance of the unknowns and the disturbance together.
    Eigen::MatrixXd beside(const Eigen::MatrixXd& covariance) const {
        const Eigen::Index q = covariance.rows();
        const Wide across = by_state * covariance;
        Eigen::MatrixXd joint(q + 6, q + 6);
        joint.topLeftCorner(q, q) = covariance;
        joint.bottomLeftCorner(6, q) = across;
        joint.topRightCorner(q, 6) = across.transpose();
        joint.bottomRightCorner<6, 6>() = own + across * by_state.transpose();
        return joint;
    }
};

// What `tp_judged` is given, in its order.
enum Judged {
    BY_BASE,
    RESIDUAL,
    JACOBIAN,
    ROWS,
    STEP,
    WAY,
    COVARIANCE,
    VIEWS,
    IS_WRONG,
    JITTER,
    LIMIT,
    ROOM,
    REST,
    WILD,
    FOUND,
    IS_DETERMINED
};

}  // namespace

// (by the robot (n, k, 12), residuals (n, k, 2), Jacobian (n, k, 2 q), its rows (n, q), step to the
// minimum (u,), share of it that is left, covariance (u, u), views (v, 3) as picture, first and
// past the last corner, is wrong (v,), variances of the robot's deviation (n or 0, 6), most χ² of a
// corner, variances of the room (6,), rest, is wild (n, k), χ² and ln|S| (v, 2), is determined
// (v,)): 0; see `innovation.judged`.
TRIGPOINT_KERNEL(tp_judged) {
    const auto numbers = [&](Judged which) { return arguments[which].array.as<double>(); };
    const Eigen::Index pictures = arguments[BY_BASE].array.shape[0],
                       corners = arguments[BY_BASE].array.shape[1],
                       q = arguments[ROWS].array.shape[1], u = arguments[STEP].array.shape[0],
                       views = arguments[VIEWS].array.shape[0];
    if (arguments[JACOBIAN].array.shape[2] != 2 * q)
        throw std::invalid_argument("derivatives by other unknowns than the covariance is of");
    const bool is_shaken = arguments[JITTER].array.shape[0] > 0;
    if (is_shaken && arguments[JITTER].array.shape[0] != pictures)
        throw std::invalid_argument("not every picture has a deviation");
    const std::int64_t *rows = arguments[ROWS].array.as<std::int64_t>(),
                       *parts = arguments[VIEWS].array.as<std::int64_t>();
    for (Eigen::Index i = 0; i < pictures * q; ++i)
        if (rows[i] < 0 || rows[i] >= u) throw std::invalid_argument("an unknown that is none");
    for (Eigen::Index v = 0; v < views; ++v)
        if (parts[3 * v] < 0 || parts[3 * v] >= pictures || parts[3 * v + 1] < 0 ||
            parts[3 * v + 1] > parts[3 * v + 2] || parts[3 * v + 2] > corners)
            throw std::invalid_argument("a view of corners that are none");
    const In<6, 1> room(numbers(ROOM));
    bool* is_wild = arguments[WILD].array.as<bool>();
    std::fill_n(is_wild, pictures * corners, false);
    for (Eigen::Index n = 0; n < pictures; ++n) {
        const Eigen::Map<const RowMajor> jacobian(numbers(JACOBIAN) + 2 * corners * q * n,
                                                  2 * corners, q);
        const Eigen::Map<const ByPoses> by_base(numbers(BY_BASE) + 12 * corners * n, 2 * corners,
                                                6);
        Eigen::VectorXd step(q), left = Eigen::Map<const Eigen::VectorXd>(
                                     numbers(RESIDUAL) + 2 * corners * n, 2 * corners);
        Eigen::MatrixXd covariance(q, q);
        for (Eigen::Index i = 0; i < q; ++i) {
            step(i) = numbers(STEP)[rows[n * q + i]];
            for (Eigen::Index j = 0; j < q; ++j)
                covariance(i, j) = numbers(COVARIANCE)[rows[n * q + i] * u + rows[n * q + j]];
        }
        left += arguments[WAY].number * (jacobian * step);
        std::vector<Eigen::VectorXd> weights(static_cast<std::size_t>(views));
        Eigen::VectorXd good = Eigen::VectorXd::Zero(2 * corners);
        const auto mine = [&](Eigen::Index v) { return parts[3 * v] == n; };
        for (Eigen::Index v = 0; v < views; ++v) {
            if (!mine(v)) continue;
            const Eigen::Index first = parts[3 * v + 1], count = parts[3 * v + 2] - first;
            Eigen::VectorXd& weight = weights[static_cast<std::size_t>(v)];
            tame_step(
                {{by_base.data() + 12 * first, 2 * count, 6}, {left.data() + 2 * first, 2 * count}},
                arguments[LIMIT].number, weight);
            for (Eigen::Index k = 0; k < count; ++k) {
                is_wild[n * corners + first + k] = weight(k) == 0;
                if (weight(k) != 0 && !arguments[IS_WRONG].array.as<bool>()[v])
                    good.segment<2>(2 * (first + k)).setOnes();
            }
        }
        RowMajor by_state = jacobian;
        if (is_shaken) {
            const Stood stood(good.asDiagonal() * by_base, good.cwiseProduct(left),
                              good.asDiagonal() * jacobian, In<6, 1>(numbers(JITTER) + 6 * n));
            covariance = stood.beside(covariance);
            left += by_base * stood.shift;
            by_state.resize(2 * corners, q + 6);
            by_state << jacobian, by_base;
        }
        for (Eigen::Index v = 0; v < views; ++v) {
            if (!mine(v)) continue;
            const Eigen::Index first = parts[3 * v + 1], count = parts[3 * v + 2] - first;
            const Innovation found = innovation(
                {{by_base.data() + 12 * first, 2 * count, 6}, {left.data() + 2 * first, 2 * count}},
                by_state.middleRows(2 * first, 2 * count), weights[static_cast<std::size_t>(v)],
                covariance, room, !arguments[IS_WRONG].array.as<bool>()[v], arguments[REST].number);
            numbers(FOUND)[2 * v] = found.chi2;
            numbers(FOUND)[2 * v + 1] = found.log_spread;
            arguments[IS_DETERMINED].array.as<bool>()[v] = found.is_determined;
        }
    }
    return 0;
}
