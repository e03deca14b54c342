#include "fusion/motion.hpp"

#include <Eigen/Cholesky>
#include <stdexcept>

#include "border.hpp"

namespace trigpoint {

namespace {

using Index = Eigen::Index;

constexpr std::int64_t SPATIAL[] = {0, 1, 2, 3, 4, 5}, PLANAR[] = {0, 1, 5};

}  // namespace

std::int64_t moment(std::int64_t stamp_ns) {
    if (stamp_ns < -MOST_NS || stamp_ns > MOST_NS)
        throw std::invalid_argument("a moment that is none");
    return stamp_ns;
}

Tangent::Tangent(const std::int64_t* given, Index how_many) : axes(given), count(how_many) {
    if (count > 6) throw std::out_of_range("a pose has six components");
    for (Index i = 0; i < count; ++i)
        if (axes[i] < 0 || axes[i] > 5) throw std::out_of_range("a pose has six components");
}

Tangent Tangent::of(bool is_planar) { return is_planar ? Tangent(PLANAR, 3) : Tangent(SPATIAL, 6); }

Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& v) {
    const double squared = v.squaredNorm(), angle = std::sqrt(squared);
    const bool is_small = squared < 1e-8;
    const double first = is_small ? 0.5 - squared / 24 : (1 - std::cos(angle)) / squared;
    const double second =
        is_small ? 1.0 / 6 - squared / 120 : (angle - std::sin(angle)) / (squared * angle);
    const Eigen::Matrix3d cross = hat(v);
    return Eigen::Matrix3d::Identity() + first * cross + second * (cross * cross);
}

Pose motion_of(const Vector6d& twist) {
    const Eigen::Vector3d turn = twist.tail<3>();
    return {exp(turn), left_jacobian(turn) * twist.head<3>()};
}

Pose moved(const Pose& pose, const Vector6d& by) {
    Vector6d twist = by;
    twist.head<3>() -= by.tail<3>().cross(pose.translation);
    return motion_of(twist).times(pose);
}

void relative_jacobians(const Pose& a, const Pose& b, Matrix6d& by_a, Matrix6d& by_b) {
    const Eigen::Matrix3d to_a = a.rotation.transpose();
    by_b.setZero();
    by_b.topLeftCorner<3, 3>() = by_b.bottomRightCorner<3, 3>() = to_a;
    by_a = -by_b;
    by_a.topRightCorner<3, 3>() = to_a * hat(b.translation - a.translation);
}

AtMost6 whitening(const double* covariance, const Tangent& tangent) {
    AtMost6 free(tangent.count, tangent.count);
    for (Index i = 0; i < tangent.count; ++i)
        for (Index j = 0; j < tangent.count; ++j)
            free(i, j) = covariance[6 * tangent.axes[i] + tangent.axes[j]];
    const Eigen::LLT<AtMost6> root(free);
    if (!(root.matrixLLT().diagonal().array() > 0).all() || root.info() != Eigen::Success)
        throw Undetermined();
    AtMost6 white = AtMost6::Identity(tangent.count, tangent.count);
    root.matrixL().solveInPlace(white);
    return white;
}

// t = R_iᵀ(t_j - t_i) - Δt, r = Log(R_iᵀ R_j ΔRᵀ). A disturbance of R_iᵀ R_j turns r by J_l⁻¹(r)
// (Solà et al.), one of ΔR by -J_r⁻¹(r), where J_r(r) = J_l(-r) = J_l(r)ᵀ.
OdometryTerm::OdometryTerm(const Pose& earlier, const Pose& later, const Pose& motion,
                           const BySteps& by_scale, const Tangent& tangent, const AtMost6& white) {
    const Vector6d whole = earlier.inverse().times(later).difference(motion);
    Matrix6d by_earlier, by_later;
    relative_jacobians(earlier, later, by_earlier, by_later);
    const Eigen::Matrix3d inverse = left_jacobian(whole.tail<3>()).inverse();
    const Eigen::Matrix3d turning = inverse * by_later.bottomRightCorner<3, 3>();
    by_later.bottomRightCorner<3, 3>() = turning;
    by_earlier.bottomRightCorner<3, 3>() = -turning;
    BySteps scaling = -by_scale;
    scaling.bottomRows<3>() = inverse.transpose() * -by_scale.bottomRows<3>();
    const Index d = tangent.count;
    residual.resize(d);
    by.resize(d, 2 * d + 2);
    for (Index i = 0; i < d; ++i) {
        residual[i] = whole[tangent.axes[i]];
        for (Index j = 0; j < d; ++j) {
            by(i, j) = by_earlier(tangent.axes[i], tangent.axes[j]);
            by(i, d + j) = by_later(tangent.axes[i], tangent.axes[j]);
        }
        by.row(i).tail<2>() = scaling.row(tangent.axes[i]);
    }
    residual = (white * residual).eval();
    by = (white * by).eval();
}

}  // namespace trigpoint

using namespace trigpoint;

// (earlier (n, 12), later (n, 12), motion (n, 12), its covariance (n, 6, 6), by the scales
// (n, 6, 2), tangent (d,), residual (n, d), by earlier (n, d, d), by later (n, d, d), by the scales
// (n, d, 2)): 1, or 0 where a covariance is not positive definite; see `odometry_terms`.
TRIGPOINT_KERNEL(tp_odometry_terms) {
    const Tangent tangent(arguments[5].array.as<std::int64_t>(), arguments[5].array.shape[0]);
    const Index count = arguments[0].array.shape[0], d = tangent.count;
    const auto numbers = [&](int which) { return arguments[which].array.as<double>(); };
    try {
        for (Index n = 0; n < count; ++n) {
            const auto pose = [&](int which) { return pose_at(numbers(which) + 12 * n); };
            const OdometryTerm term(pose(0), pose(1), pose(2),
                                    Eigen::Map<const BySteps>(numbers(4) + 12 * n), tangent,
                                    whitening(numbers(3) + 36 * n, tangent));
            Eigen::Map<Eigen::VectorXd>(numbers(6) + d * n, d) = term.residual;
            Eigen::Map<RowMajor>(numbers(7) + d * d * n, d, d) = term.by.leftCols(d);
            Eigen::Map<RowMajor>(numbers(8) + d * d * n, d, d) = term.by.middleCols(d, d);
            Eigen::Map<RowMajor>(numbers(9) + 2 * d * n, d, 2) = term.by.rightCols(2);
        }
    } catch (const Undetermined&) {
        return 0;
    }
    return 1;
}
