// Poses of least reprojection error, and corners that no pose explains.
#include "fusion/pose_fitting.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <limits>
#include <stdexcept>
#include <vector>

#include "border.hpp"

using namespace trigpoint;

namespace {

constexpr int MOST_STEPS = 10;
constexpr double SMALLEST_STEP = 1e-7, FARTHEST_M = 1e3;
// Of the largest eigenvalue: directions that nothing determines are not changed.
constexpr double OPEN = 1e-12, OPEN_COVARIANCE = 1e-14;

// The inverse of a symmetric matrix in the directions that it determines.
Matrix6d inverse_of(const Matrix6d& normal, double open) {
    const Eigen::SelfAdjointEigenSolver<Matrix6d> parts(normal);
    const auto values = parts.eigenvalues().array();
    const double least = open * values.abs().maxCoeff();
    const Vector6d inverse = (values.abs() > least).select(values.inverse(), 0.0);
    return parts.eigenvectors() * inverse.asDiagonal() * parts.eigenvectors().transpose();
}

constexpr int MOST_WEIGHINGS = 6, MOST_REFITS = 3, LEAST_GOOD = 4;
// Share of the information that is added to it: keeps a direction that no corner shows solvable.
constexpr double SHARE = 1e-14;

// The weighted least-squares step, and the χ² that it leaves of every corner.
Vector6d weighted_step(const Sighting& seen, const Eigen::VectorXd& weight, Eigen::VectorXd& left) {
    Matrix6d normal = Matrix6d::Zero();
    Vector6d gradient = Vector6d::Zero();
    for (Eigen::Index k = 0; k < seen.corners(); ++k) {
        const auto by = seen.by_pose.middleRows<2>(2 * k);
        normal.noalias() += weight(k) * (by.transpose() * by);
        gradient.noalias() += weight(k) * (by.transpose() * seen.residual.segment<2>(2 * k));
    }
    // Collinear corners leave a direction undetermined; the step along it is zero.
    normal.diagonal() += (SHARE * normal.diagonal()).array().matrix();
    normal.diagonal().array() += SHARE;
    const Vector6d step = -normal.partialPivLu().solve(gradient);
    const Eigen::VectorXd all = seen.residual + seen.by_pose * step;
    left = Eigen::Map<const Eigen::Matrix<double, 2, Eigen::Dynamic>>(all.data(), 2, seen.corners())
               .colwise()
               .squaredNorm();
    return step;
}

// Weights of corners: 0 for those that are wild, else 1; all 1 where no such choice settles.
Eigen::VectorXd settled_weights(const Sighting& seen, double limit) {
    const Eigen::Index count = seen.corners();
    Eigen::VectorXd weight = Eigen::VectorXd::Ones(count), left(count);
    std::vector<double> sorted(static_cast<std::size_t>(count));
    for (int round = 0; round < MOST_WEIGHINGS; ++round) {  // Cauchy's
        weighted_step(seen, weight, left);
        std::copy(left.data(), left.data() + count, sorted.begin());
        std::sort(sorted.begin(), sorted.end());
        const auto half = static_cast<std::size_t>(count / 2);
        const double middle = count % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
        weight = (1 + left.array() / std::max(2.0, 2 * middle)).inverse();
    }
    for (int round = 0; round < MOST_REFITS; ++round) {
        weighted_step(seen, weight, left);
        const Eigen::VectorXd good = (left.array() <= limit).cast<double>();
        if (good.sum() >= LEAST_GOOD) weight = good;  // fewer good corners are no board
    }
    const bool is_settled = (weight.array() == 0 || weight.array() == 1).all();
    if (!is_settled || (weight.array() > 0).count() < LEAST_GOOD) weight.setOnes();
    return weight;
}

// A board's corners about a pose, in sigmas.
class Linearised {
public:
    Linearised(const Lens& lens, const Points3& points, const Pixels& pixels, double weight)
        : lens_(lens),
          points_(points),
          pixels_(pixels),
          weight_(weight),
          by_pose_(2 * points.rows(), 6),
          residual_(2 * points.rows()) {}

    void about(const Pose& pose) {
        const Pose camera{Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
        for (Eigen::Index k = 0; k < points_.rows(); ++k) {
            const Projected found = projected(lens_, pose, points_.row(k).transpose(), camera);
            by_pose_.middleRows<2>(2 * k) = weight_ * found.by_body;
            residual_.segment<2>(2 * k) = weight_ * (found.pixel - pixels_.row(k).transpose());
        }
    }
    Sighting sighting() const {
        return {{by_pose_.data(), by_pose_.rows(), 6}, {residual_.data(), residual_.size()}};
    }
    Eigen::VectorXd chi2() const {
        return Eigen::Map<const Eigen::Matrix<double, 2, Eigen::Dynamic>>(residual_.data(), 2,
                                                                          points_.rows())
            .colwise()
            .squaredNorm();
    }
    // Of the pose, by the corners that are not wild.
    Matrix6d information(const Eigen::VectorXd& weight) const {
        Matrix6d sum = Matrix6d::Zero();
        for (Eigen::Index k = 0; k < points_.rows(); ++k)
            if (weight(k) != 0)
                sum.noalias() +=
                    by_pose_.middleRows<2>(2 * k).transpose() * by_pose_.middleRows<2>(2 * k);
        return sum;
    }

private:
    const Lens& lens_;
    const Points3& points_;
    const Pixels& pixels_;
    double weight_;
    ByPoses by_pose_;
    Eigen::VectorXd residual_;
};

}  // namespace

Vector6d trigpoint::tame_step(const Sighting& seen, double limit, Eigen::VectorXd& weight) {
    Eigen::VectorXd left(seen.corners());
    weight = Eigen::VectorXd::Ones(seen.corners());
    const Vector6d step = weighted_step(seen, weight, left);
    if (!(left.array() > limit).any()) return step;
    weight = settled_weights(seen, limit);
    return weighted_step(seen, weight, left);
}

double trigpoint::refine(const Lens& lens, Pose& pose, const Points3& points, const Pixels& pixels,
                         const Weights& weights) {
    const double none = std::numeric_limits<double>::quiet_NaN();
    const Pose camera{Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
    double rms = none;
    for (int round = 0; round < MOST_STEPS; ++round) {
        Matrix6d normal = Matrix6d::Zero();
        Vector6d gradient = Vector6d::Zero();
        double squares = 0;
        for (Eigen::Index k = 0; k < points.rows(); ++k) {
            const Projected found = projected(lens, pose, points.row(k).transpose(), camera);
            const Eigen::Vector2d residual = weights(k) * (found.pixel - pixels.row(k).transpose());
            if (!found.is_ahead || !residual.allFinite()) return none;
            const ByPose by = weights(k) * found.by_body;
            normal.noalias() += by.transpose() * by;
            gradient.noalias() += by.transpose() * residual;
            squares += residual.squaredNorm();
        }
        if (!normal.allFinite()) return none;
        rms = std::sqrt(squares / static_cast<double>(2 * points.rows()));
        const Vector6d step = -(inverse_of(normal, OPEN) * gradient);
        pose = pose.disturbed(step);
        if (step.cwiseAbs().maxCoeff() < SMALLEST_STEP) break;
    }
    return pose.translation.norm() < FARTHEST_M ? rms : none;
}

Matrix6d trigpoint::covariance_of(const Lens& lens, const Pose& pose, const Points3& points,
                                  double sigma, const Eigen::VectorXd& sigmas, double scale) {
    const double weight = 1 / sigma;
    const Pose camera{Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
    const Eigen::Index parameters = sigmas.size();
    Eigen::MatrixXd by_lens(2, lens.parameters());
    Matrix6d normal = Matrix6d::Zero();
    Eigen::Matrix<double, 6, Eigen::Dynamic> pull = decltype(pull)::Zero(6, parameters);
    for (Eigen::Index k = 0; k < points.rows(); ++k) {
        const Eigen::Vector3d point = points.row(k).transpose();
        const ByPose by = weight * projected(lens, pose, point, camera).by_body;
        normal.noalias() += by.transpose() * by;
        if (parameters == 0) continue;
        lens.by_parameters(pose.rotation * point + pose.translation, by_lens);
        pull.noalias() += by.transpose() * (weight * by_lens) * sigmas.asDiagonal();
    }
    if (!normal.allFinite() || !pull.allFinite())
        throw std::invalid_argument("a corner that no camera sees");
    const Matrix6d own = inverse_of(normal, OPEN_COVARIANCE);
    const Eigen::Matrix<double, 6, Eigen::Dynamic> by = own * pull;
    return scale * scale * own + by * by.transpose();
}

// (by pose (v, n, 12), residuals (v, n, 2), limit, steps (v, 6), is wild (v, n)): each sighting's
// step without its wild corners.
TRIGPOINT_KERNEL(tp_without_wild) {
    const Array &by_pose = arguments[0].array, &residuals = arguments[1].array;
    const Eigen::Index corners = by_pose.shape[1];
    for (Eigen::Index v = 0; v < by_pose.shape[0]; ++v) {
        const Sighting seen{{by_pose.as<double>() + 12 * corners * v, 2 * corners, 6},
                            {residuals.as<double>() + 2 * corners * v, 2 * corners}};
        Eigen::VectorXd weight;
        const Vector6d step = tame_step(seen, arguments[2].number, weight);
        Eigen::Map<Vector6d>(arguments[3].array.as<double>() + 6 * v) = step;
        for (Eigen::Index k = 0; k < corners; ++k)
            arguments[4].array.as<bool>()[v * corners + k] = weight(k) == 0;
    }
    return 0;
}

// (lens (p,), points (n, 3), pixels (n, 2), sigma, limit, rotations (b, 3, 3), translations (b, 3),
// scores (b,), χ² (b, n), is wild (b, n)): how a board fits from several poses; see `sightings`.
TRIGPOINT_KERNEL(tp_board_fits) {
    const Lens lens(arguments[0].array.as<double>(), arguments[0].array.shape[0]);
    const Eigen::Index count = arguments[1].array.shape[0];
    const Points3 points(arguments[1].array.as<double>(), count, 3);
    const Pixels pixels(arguments[2].array.as<double>(), count, 2);
    const double limit = arguments[4].number;
    Linearised at(lens, points, pixels, 1 / arguments[3].number);
    for (Eigen::Index b = 0; b < arguments[5].array.shape[0]; ++b) {
        Pose pose = pose_at(arguments[5].array.as<double>(), arguments[6].array.as<double>(), b);
        Eigen::VectorXd weight;
        at.about(pose);
        for (int round = 0; round < MOST_REFITS; ++round) {
            pose = pose.disturbed(tame_step(at.sighting(), limit, weight));
            at.about(pose);
        }
        const Matrix6d information = at.information(weight);
        const Eigen::VectorXd chi2 = at.chi2();
        double score = information.partialPivLu().matrixLU().diagonal().array().abs().log().sum();
        for (Eigen::Index k = 0; k < count; ++k) {
            score += weight(k) == 0 ? limit : chi2(k);
            arguments[8].array.as<double>()[b * count + k] = chi2(k);
            arguments[9].array.as<bool>()[b * count + k] = weight(k) == 0;
        }
        arguments[7].array.as<double>()[b] = score;
    }
    return 0;
}
