// Poses of least reprojection error.
#pragma once

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
