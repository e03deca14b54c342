// Motions of a robot: its free directions, constant twists, and the term of odometry in a cost.
#pragma once

#include <Eigen/LU>
#include <cstdint>

#include "geometry/pose.hpp"

namespace trigpoint {

// A twist of which no part is so large is no motion; as STILL of `motion.py`.
constexpr double STILL = 1e-9;

// Moments and spans of time beyond this are none: the differences of others are numbers.
constexpr std::int64_t MOST_NS = 4'000'000'000'000'000'000;
// The stamp of a moment; throws std::invalid_argument where it is none.
std::int64_t moment(std::int64_t stamp_ns);

// The free components of a node's disturbance, of six.
struct Tangent {
    const std::int64_t* axes;
    Eigen::Index count;

    // Throws std::out_of_range where these are none.
    Tangent(const std::int64_t* given, Eigen::Index how_many);
    // Of a robot in the plane (x, y, heading), or in space.
    static Tangent of(bool is_planar);
};

// J with Exp(v + δ) ≈ Exp(J δ) Exp(v) (Solà et al., eq. 145).
Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& v);

// The motion of a constant twist over a unit of time.
Pose motion_of(const Vector6d& twist);

// `Pose.moved` of Python: a disturbance that many poses share moves them as one rigid motion.
Pose moved(const Pose& pose, const Vector6d& by);

// Derivatives of the disturbance of a_from_b by those of a and of b in their parent.
void relative_jacobians(const Pose& a, const Pose& b, Matrix6d& by_a, Matrix6d& by_b);

using AtMost6 = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 6, 6>;
using BySteps = Eigen::Matrix<double, 6, 2, Eigen::RowMajor>;

// The inverse of the Cholesky factor of a motion's covariance (6, 6) in the free directions; throws
// Undetermined where that is not positive definite.
AtMost6 whitening(const double* covariance, const Tangent& tangent);
struct Undetermined : std::exception {};

// Odometry's whitened residual (d,), and its derivatives by the earlier and the later node (d each)
// and by the scales (2).
struct OdometryTerm {
    Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, 6> residual;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 6, 14> by;

    OdometryTerm(const Pose& earlier, const Pose& later, const Pose& motion,
                 const BySteps& by_scale, const Tangent& tangent, const AtMost6& white);
};

}  // namespace trigpoint
