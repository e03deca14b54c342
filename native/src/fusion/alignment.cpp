// Where a robot is before a located camera, by the corners of one picture and what was known
// before; see `fusion/reading/alignment.py`.
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/motion.hpp"
#include "fusion/pose_fitting.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Step = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, 6>;
using Row = Eigen::Matrix<double, 1, Eigen::Dynamic, Eigen::RowMajor, 1, 6>;

constexpr int MOST_STEPS = 12;
// After a step this small, m and rad, the next one would be its square: negligible.
constexpr double SMALL_STEP = 1e-4;
// Of the largest eigenvalue: directions that nothing determines are not changed.
constexpr double OPEN = 1e-12;

// The equations of a robot's pose: the corners of a picture and, where there is one, a prior. All
// in sigmas; the prior's rows follow the corners'.
class Equations {
public:
    // The lens (p,), the camera (1, 12), pixels (n, 2), weights (n,), the prior's pose (1 or 0, 12)
    // and the root of its information (r, d), the robot's free directions (d,).
    static constexpr int ARGUMENTS = 7;

    explicit Equations(const Argument* given)
        : lens_(given[0].array.as<double>(), given[0].array.shape[0]),
          camera_(pose_at(given[1].array.as<double>())),
          pixels_(given[2].array.as<double>(), given[2].array.shape[0], 2),
          weights_(given[3].array.as<double>(), given[3].array.shape[0]),
          root_(given[5].array.as<double>(), given[5].array.shape[0], given[5].array.shape[1]),
          tangent_(given[6].array.as<std::int64_t>(), given[6].array.shape[0]),
          jacobian_(2 * corners() + root_.rows(), tangent_.count),
          residual_(jacobian_.rows()) {
        const bool is_known = given[4].array.shape[0] == 1;
        if (tangent_.count == 0) throw std::invalid_argument("a robot that cannot move");
        if (is_known != (root_.rows() > 0) || (is_known && root_.rows() != tangent_.count))
            throw std::invalid_argument("a prior is a pose and as many rows as directions");
        if (is_known) prior_ = pose_at(given[4].array.as<double>());
    }

    Index corners() const { return pixels_.rows(); }
    // Of the corners (2 n,).
    auto apart() const { return residual_.head(2 * corners()); }
    // By how many sigmas the prior is contradicted, squared.
    double pull() const { return residual_.tail(root_.rows()).squaredNorm(); }

    // Sets them about a pose, for corners (n, 3) in the robot's frame; false where a corner is not
    // before the camera.
    bool about(const Pose& pose, const double* points) {
        for (Index k = 0; k < corners(); ++k) {
            const Projected found =
                projected(lens_, pose, Eigen::Map<const Eigen::Vector3d>(points + 3 * k), camera_);
            const double weight = weights_[k];
            residual_.segment<2>(2 * k) = weight * (found.pixel - pixels_.row(k).transpose());
            for (Index i = 0; i < tangent_.count; ++i)
                jacobian_.block<2, 1>(2 * k, i) = weight * found.by_body.col(tangent_.axes[i]);
            if (!found.is_ahead) return false;
        }
        if (root_.rows() > 0) {
            const Vector6d whole = pose.difference(prior_);
            Step free(tangent_.count);
            for (Index i = 0; i < tangent_.count; ++i) free[i] = whole[tangent_.axes[i]];
            residual_.tail(root_.rows()).noalias() = root_ * free;
            jacobian_.bottomRows(root_.rows()) = root_;
        }
        return residual_.allFinite() && jacobian_.allFinite();
    }
    // The least-squares step, each corner at its own weight (n,); the prior at its own.
    Step step(const Eigen::VectorXd& weight) const {
        AtMost6 normal = AtMost6::Zero(tangent_.count, tangent_.count);
        Step gradient = Step::Zero(tangent_.count);
        for (Index row = 0; row < residual_.size(); ++row) {
            const double own = row < 2 * corners() ? weight[row / 2] : 1;
            const Row by = own * jacobian_.row(row);
            normal.noalias() += jacobian_.row(row).transpose() * by;
            gradient.noalias() += by.transpose() * residual_[row];
        }
        if (root_.rows() > 0) return -normal.partialPivLu().solve(gradient);
        const Eigen::SelfAdjointEigenSolver<AtMost6> parts(normal);
        const auto values = parts.eigenvalues().array();
        const double least = OPEN * values.abs().maxCoeff();
        const Step inverse = (values.abs() > least).select(values.inverse(), 0.0);
        return -(parts.eigenvectors() * inverse.asDiagonal() *
                 (parts.eigenvectors().transpose() * gradient));
    }
    // χ², the prior's included, after a step.
    double cost_after(const Step& step) const {
        return (residual_ + jacobian_ * step).squaredNorm();
    }
    Pose moved(const Pose& pose, const Step& step) const {
        Vector6d whole = Vector6d::Zero();
        for (Index i = 0; i < tangent_.count; ++i) whole[tangent_.axes[i]] = step[i];
        return pose.disturbed(whole);
    }

private:
    Lens lens_;
    Pose camera_, prior_{};
    Pixels pixels_;
    Weights weights_;
    Eigen::Map<const RowMajor> root_;
    Tangent tangent_;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> jacobian_;
    Eigen::VectorXd residual_;
};

double median(std::vector<double> values) {
    std::sort(values.begin(), values.end());
    const std::size_t half = values.size() / 2;
    return values.size() % 2 ? values[half] : (values[half - 1] + values[half]) / 2;
}

}  // namespace

// (equations, points (b, n, 3) in the robot's frame, poses to start from (b, 12), poses (b, 12),
// χ² (b,)): Gauss-Newton; infinite where a corner is not before the camera.
TRIGPOINT_KERNEL(tp_aligned) {
    Equations at(arguments);
    const Argument* asked = arguments + Equations::ARGUMENTS;
    const Eigen::VectorXd whole = Eigen::VectorXd::Ones(at.corners());
    for (Index b = 0; b < asked[0].array.shape[0]; ++b) {
        const double* points = asked[0].array.as<double>() + 3 * at.corners() * b;
        Pose pose = pose_at(asked[1].array.as<double>() + 12 * b);
        double cost = std::numeric_limits<double>::infinity();
        for (int round = 0; round < MOST_STEPS; ++round) {
            if (!at.about(pose, points)) {
                cost = std::numeric_limits<double>::infinity();
                break;
            }
            const Step step = at.step(whole);
            cost = at.cost_after(step);
            pose = at.moved(pose, step);
            if (step.cwiseAbs().maxCoeff() < SMALL_STEP) break;
        }
        if (std::isnan(cost)) cost = std::numeric_limits<double>::infinity();
        put_pose(pose, asked[2].array.as<double>() + 12 * b);
        asked[3].array.as<double>()[b] = cost;
    }
    return 0;
}

// (equations, points (b, n, 3) in the robot's frame, its pose (1, 12), χ² (b,)): that of each to
// first order about the pose; infinite where a corner is not before the camera.
TRIGPOINT_KERNEL(tp_aligned_nearly) {
    Equations at(arguments);
    const Argument* asked = arguments + Equations::ARGUMENTS;
    const Pose pose = pose_at(asked[1].array.as<double>());
    const Eigen::VectorXd whole = Eigen::VectorXd::Ones(at.corners());
    for (Index b = 0; b < asked[0].array.shape[0]; ++b) {
        const bool is_sound = at.about(pose, asked[0].array.as<double>() + 3 * at.corners() * b);
        asked[2].array.as<double>()[b] =
            is_sound ? at.cost_after(at.step(whole)) : std::numeric_limits<double>::infinity();
    }
    return 0;
}

// (equations, points (n, 3) in the robot's frame, its pose (1, 12), lengths of the corners'
// residuals (n,), the prior's χ² (1,)): about the best pose by Cauchy's weights, with a scale that
// leaves most corners near their full weight; 1, or 0 where a corner is not before the camera.
TRIGPOINT_KERNEL(tp_aligned_robustly) {
    Equations at(arguments);
    const Argument* asked = arguments + Equations::ARGUMENTS;
    Pose pose = pose_at(asked[1].array.as<double>());
    Eigen::Map<Eigen::VectorXd> length(asked[2].array.as<double>(), at.corners());
    if (at.corners() == 0) return 0;
    for (int round = 0; round < MOST_STEPS; ++round) {
        if (!at.about(pose, asked[0].array.as<double>())) return 0;
        for (Index k = 0; k < at.corners(); ++k) length[k] = at.apart().segment<2>(2 * k).norm();
        const double middle = median({length.data(), length.data() + length.size()});
        const double scale = std::max(2.0, 2 * middle);
        pose = at.moved(pose, at.step((1 + (length.array() / scale).square()).inverse()));
    }
    asked[3].array.as<double>()[0] = at.pull();
    return 1;
}
