// Rigid transforms and their disturbances, by the contract.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace trigpoint {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
// As numpy lays arrays out.
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// The matrix of the cross product.
inline Eigen::Matrix3d hat(const Eigen::Vector3d& v) {
    Eigen::Matrix3d cross;
    cross << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
    return cross;
}

// The rotation of a rotation vector (Rodrigues).
inline Eigen::Matrix3d exp(const Eigen::Vector3d& v) {
    const double squared = v.squaredNorm(), angle = std::sqrt(squared);
    const bool is_small = squared < 1e-8;
    const double sine = is_small ? 1 - squared / 6 : std::sin(angle) / angle;
    const double versine = is_small ? 0.5 - squared / 24 : (1 - std::cos(angle)) / squared;
    const Eigen::Matrix3d cross = hat(v);
    return Eigen::Matrix3d::Identity() + sine * cross + versine * (cross * cross);
}

// The rotation vector of a rotation, of length at most π.
inline Eigen::Vector3d log(const Eigen::Matrix3d& rotation) {
    Eigen::Quaterniond turn(rotation);
    if (turn.w() < 0) turn.coeffs() = -turn.coeffs();
    const double length = turn.vec().norm();
    return length < 1e-9
               ? Eigen::Vector3d(2 * turn.vec())
               : Eigen::Vector3d(turn.vec() * (2 * std::atan2(length, turn.w()) / length));
}

struct Pose {
    Eigen::Matrix3d rotation;
    Eigen::Vector3d translation;

    Pose inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation)}; }

    // a_from_b of this, with b_from_c: a_from_c.
    Pose times(const Pose& other) const {
        return {rotation * other.rotation, rotation * other.translation + translation};
    }
    // The disturbance that takes the other to this.
    Vector6d difference(const Pose& other) const {
        Vector6d found;
        found << translation - other.translation, log(rotation * other.rotation.transpose());
        return found;
    }

    // The disturbance (metres, radians) in the parent's axes: t' = t + δt, R' = Exp(δθ) R.
    Pose disturbed(const Vector6d& by) const {
        return {exp(by.tail<3>()) * rotation, translation + by.head<3>()};
    }
};

// One of many poses as Python has them, row by row.
inline Pose pose_at(const double* rotations, const double* translations, Eigen::Index index) {
    using Rows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    return {Eigen::Map<const Rows>(rotations + 9 * index),
            Eigen::Map<const Eigen::Vector3d>(translations + 3 * index)};
}

// Of twelve numbers, its rotation row by row and its translation; and written as such.
inline Pose pose_at(const double* numbers) { return pose_at(numbers, numbers + 9, 0); }

// Writes one of many poses there.
inline void put_pose(const Pose& pose, double* rotations, double* translations,
                     Eigen::Index index) {
    using Rows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    Eigen::Map<Rows>(rotations + 9 * index) = pose.rotation;
    Eigen::Map<Eigen::Vector3d>(translations + 3 * index) = pose.translation;
}
inline void put_pose(const Pose& pose, double* numbers) { put_pose(pose, numbers, numbers + 9, 0); }

}  // namespace trigpoint
