// Poses of least reprojection error.
#pragma once

#include "fusion/projection.hpp"

namespace trigpoint {

using Points3 = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;
using Pixels = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>>;
using Weights = Eigen::Map<const Eigen::VectorXd>;

// camera_from_object, and the RMS of a coordinate in sigmas.
struct Fit {
    Pose pose;
    double rms;
};

// Gauss-Newton from a pose; the RMS of the residuals, NaN where it diverges.
double refine(const Lens& lens, Pose& pose, const Points3& points, const Pixels& pixels,
              const Weights& weights);

}  // namespace trigpoint
