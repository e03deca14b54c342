// The corners of a picture: residuals, their derivatives by every unknown, and the normal equations
// of these.
#pragma once

#include <vector>

#include "fusion/motion.hpp"
#include "fusion/pose_fitting.hpp"

namespace trigpoint {

// A picture of a robot, at a state.
struct Picture {
    Lens lens;
    Pose camera;
    Pose node, seen;      // of the robot, and as it was seen
    const double* twist;  // (6,) of it then; null where the clock is not estimated
    double since_epoch_s;
    const std::vector<Pose>& faces;
    Tangent tangent;
    bool has_lens;                                  // whether it is estimated
    const std::vector<Eigen::Index>& face_columns;  // those of which the poses are, in their order
    Eigen::Index corners;
    const std::int64_t* face;  // (k,)
    const double* points;      // (k, 3), in their faces
    const double* pixels;      // (k, 2)
    const double* weights;     // (k,)

    // Of the node, 6 of the camera, p of its lens, 2 of its clock, and 6 of each face that has
    // columns, as far as they are estimated.
    Eigen::Index columns() const;
    // Residuals (2 k,) with the robot seen at a pose, their derivatives by the unknowns
    // (2 k, columns) and by that pose (2 k, 6), where these have rows. Throws std::out_of_range.
    void terms(const Pose& robot, Eigen::Ref<Eigen::VectorXd> residual,
               Eigen::Ref<RowMajor> jacobian, Eigen::Ref<ByPoses> by_seen) const;
};

// The normal equations of a picture, with the robot's deviation in it eliminated about its best
// fit: what is left of a tilt has one sign in all pictures. That fit is by the picture's own
// variances: a tilt that hundreds of pictures share counts in each as if it were of degrees, and
// about such a fit hardly a step leads to the minimum. The derivatives are those at none: what
// deviations explain then counts by a fixed covariance. At the fit they would be the cost's own,
// which falls as a lever grows, and a target that is mounted unknown to 3 mm came out 12 mm higher.
struct PictureEquations {
    Eigen::MatrixXd square;  // of the unknowns and, last, the residual
    double cost = 0, log_determinant = 0;

    // `variances` (12,) of the deviation, null where there is none: by which it counts, and then
    // those in this picture by itself; corners beyond `huber` sigmas have a linear cost.
    void set(Picture picture, const double* variances, double huber);
    // The triangular factor (c, c) of the last picture's equations, of unit noise, in the unknowns
    // and, last, the residual: its squares add up to `square`.
    Eigen::MatrixXd factor() const;

private:
    void set_square();

    Eigen::Matrix<double, 6, Eigen::Dynamic> own_;  // of the deviation's prior
    RowMajor rows_;
    ByPoses by_seen_;
    Eigen::VectorXd residual_, left_, root_;
};

}  // namespace trigpoint
