// Poses of least reprojection error.
#pragma once

#include <array>

#include "fusion/projection.hpp"

namespace trigpoint {

using Points3 = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;
using Pixels = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>>;
using Weights = Eigen::Map<const Eigen::VectorXd>;

using ByPoses = Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>;

// camera_from_object, and the RMS of a coordinate in sigmas.
struct Fit {
    Pose pose;
    double rms;
};

// Gauss-Newton from a pose; the RMS of the residuals, NaN where it diverges.
double refine(const Lens& lens, Pose& pose, const Points3& points, const Pixels& pixels,
              const Weights& weights);

// Both poses of one plane, best first, and how many there are; see `planar_poses`.
std::size_t plane_poses(const Lens& lens, const Points3& points, const Pixels& pixels, double sigma,
                        std::array<Fit, 2>& found);

// The covariance of a camera_from_object by its corners, of which each scatters `scale` times as
// much as `sigma` says, and by the lens, whose parameters have `sigmas` or are known. Throws
// std::invalid_argument where no camera sees a corner.
Matrix6d covariance_of(const Lens& lens, const Pose& pose, const Points3& points, double sigma,
                       const Eigen::VectorXd& sigmas, double scale);

// One sighting's derivatives by its pose (2 n, 6) and its residuals (2 n,), in sigmas.
struct Sighting {
    Eigen::Map<const ByPoses> by_pose;
    Eigen::Map<const Eigen::VectorXd> residual;
    Eigen::Index corners() const { return residual.size() / 2; }
};

// The least-squares step of a sighting's pose without its wild corners, those of weight 0: whose χ²
// exceeds `limit` about a fit that starts from Cauchy weights.
Vector6d tame_step(const Sighting& seen, double limit, Eigen::VectorXd& weight);

}  // namespace trigpoint
