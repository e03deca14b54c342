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
    bool has_lens, has_faces;  // whether these are estimated
    Eigen::Index corners;
    const std::int64_t* face;  // (k,)
    const double* points;      // (k, 3), in their faces
    const double* pixels;      // (k, 2)
    const double* weights;     // (k,)

    // Of the node, 6 of the camera, p of its lens, 2 of its clock, 6 f of the faces, as far as they
    // are estimated.
    Eigen::Index columns() const;
    // With the robot seen at a pose, of each corner two rows: the derivatives of its residual by
    // that pose (6) and, where `with_lens`, by the lens (p), and the residual (1). Through these
    // everything is seen. Throws std::out_of_range.
    void terms(const Pose& robot, bool with_lens, Eigen::MatrixXd& rows) const;
    // The disturbance of a face, as one of that pose, by all unknowns but the lens, (6, columns).
    Eigen::Matrix<double, 6, Eigen::Dynamic> by_unknowns(const Pose& robot,
                                                         std::int64_t face) const;
    // The derivatives of residuals by the unknowns (2 k, columns), from their terms.
    RowMajor jacobian(const Pose& robot, const Eigen::MatrixXd& rows) const;
    // Calls `run(first, count, face)` for corners that the same unknowns move.
    template <class Run>
    void each_run(Run&& run) const {
        for (Eigen::Index first = 0, end = 0; first < corners; first = end) {
            while (end < corners && (!has_faces || face[end] == face[first])) ++end;
            run(first, end - first, face[first]);
        }
    }
};

// The normal equations of a picture, with the robot's deviation in it eliminated about its best
// fit: what is left of a tilt has one sign in all pictures. All derivatives are those there, so
// that the equations' gradient is the cost's.
struct PictureEquations {
    Eigen::MatrixXd square;  // of the unknowns and, last, the residual
    double cost = 0, log_determinant = 0;

    // `variances` (6,) of the deviation, null where there is none; corners beyond `huber` sigmas
    // have a linear cost.
    void set(const Picture& picture, const double* variances, double huber);
    // The triangular factor (c, c) of the equations that were set of that picture, of unit noise,
    // in the unknowns and, last, the residual: its squares add up to `square`.
    Eigen::MatrixXd factor(const Picture& picture, const double* variances) const;

private:
    Vector6d deviation_;           // as it is fitted
    Pose seen_;                    // with it
    Matrix6d by_deviation_;        // the disturbance there by the deviation
    Eigen::MatrixXd rows_, gram_;  // terms, and their squares
    Eigen::MatrixXd whole_;        // of the deviation, the unknowns and the residual

    void square_terms(Eigen::Index first, Eigen::Index count);
    Vector6d fitted(const Vector6d& variances, const Vector6d& about);
};

}  // namespace trigpoint
