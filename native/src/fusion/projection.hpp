// Where corners of a body fall in a picture, with the derivative by the body's pose.
#pragma once

#include "geometry/lens.hpp"
#include "geometry/pose.hpp"

namespace trigpoint {

// Points behind a camera, or nearer to its plane than this, are put this far in front of it.
constexpr double NEAREST_M = 1e-2;

using ByPose = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;

// Derivatives of a pixel by a disturbance of the pose of a body that carries the point, of which
// `arm` is the point from its origin: a row b of `by_point` times -[a]× is a × b.
inline ByPose by_disturbance(const Eigen::Matrix<double, 2, 3>& by_point,
                             const Eigen::Vector3d& arm) {
    ByPose by;
    by.leftCols<3>() = by_point;
    for (int row = 0; row < 2; ++row) {
        const Eigen::Vector3d mine = by_point.row(row).transpose();
        by.row(row).tail<3>() = arm.cross(mine).transpose();
    }
    return by;
}

struct Projected {
    Eigen::Vector2d pixel;
    ByPose by_body;  // by a disturbance of the body's pose
    bool is_ahead;
};

// A point of a body at a pose in the frame in which `camera` is one, too.
inline Projected projected(const Lens& lens, const Pose& body, const Eigen::Vector3d& point,
                           const Pose& camera) {
    const Eigen::Vector3d arm = body.rotation * point;
    Eigen::Vector3d optical =
        camera.rotation.transpose() * (arm + body.translation - camera.translation);
    Projected found;
    found.is_ahead = optical.z() > NEAREST_M;
    if (!found.is_ahead) optical.z() = NEAREST_M;
    Eigen::Matrix<double, 2, 3> by_point;
    found.pixel = lens.project(optical, by_point);
    found.by_body = by_disturbance(by_point * camera.rotation.transpose(), arm);
    return found;
}

}  // namespace trigpoint
