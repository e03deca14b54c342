// What a camera finds of a target at many poses of its robot, and the information in that.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/projection.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Points = Eigen::Matrix3Xd;
using Rows3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

// A face whose pattern is so far in front of another's plane may hide some of it.
constexpr double BEFORE_M = 1e-4;
// Shares of a line of sight that are too near to its ends to count as crossed.
constexpr double BESIDE = 1e-3;

// Points (n, 3) of one of many parts, a column each.
Points points_of(const Array& array, Index part, Index count) {
    const Index most = array.shape[1];
    return Eigen::Map<const Rows3>(array.as<double>() + 3 * most * part, count, 3).transpose();
}

// The rectangle of a face's pattern in its own frame.
struct Rectangle {
    Eigen::Array2d low, high;

    Points corners() const {
        Points found = Points::Zero(3, 4);
        found.topRows<2>() << low.x(), high.x(), high.x(), low.x(), low.y(), low.y(), high.y(),
            high.y();
        return found;
    }
    // Whether the line between two points of the face's frame goes through.
    bool is_crossed(const Eigen::Vector3d& start, const Eigen::Vector3d& end) const {
        const double share = start.z() / (start.z() - end.z());
        if (!(share > BESIDE && share < 1 - BESIDE)) return false;
        const Eigen::Array2d at = (start + share * (end - start)).head<2>();
        return (at > low).all() && (at < high).all();
    }
};

// Another face that can stand before one: its frame, and the corners of that one in it.
struct Hider {
    Pose face_from_base;
    Rectangle rectangle;
    Points corners;
};

// A face with all of its points in the base frame.
struct Face {
    Pose base_from_face;
    Points corners, nodes, sides;  // of sides the two ends, one after the other
    Index needed;
    Rectangle rectangle;
    Eigen::Vector3d middle;
    double reach, shortest;  // to the farthest corner from the middle; of the sides
    std::vector<Hider> hiders;

    bool is_hidden(Index corner, const std::vector<Eigen::Vector3d>& eyes) const {
        for (std::size_t i = 0; i < hiders.size(); ++i)
            if (hiders[i].rectangle.is_crossed(eyes[i], hiders[i].corners.col(corner))) return true;
        return false;
    }
};

Points moved(const Pose& pose, const Points& points) {
    return (pose.rotation * points).colwise() + pose.translation;
}

// (rotations (f, 3, 3), translations (f, 3), corners (f, c, 3), counts (f,), needed (f,),
// rectangles (f, 4), sides (f, s, 3), ends of sides (f,), nodes (f, 4, 3)).
std::vector<Face> faces_of(const Argument* given) {
    std::vector<Face> faces(static_cast<std::size_t>(given[0].array.shape[0]));
    Index f = 0;
    for (Face& face : faces) {
        face.base_from_face = pose_at(given[0].array.as<double>(), given[1].array.as<double>(), f);
        const auto of = [&](const Argument& argument, Index count) {
            return moved(face.base_from_face, points_of(argument.array, f, count));
        };
        const auto number = [&](int which, Index most, Index least = 1) {
            const std::int64_t count = given[which].array.as<std::int64_t>()[f];
            if (count < least || count > most)
                throw std::invalid_argument("a face without corners");
            return count;
        };
        face.corners = of(given[2], number(3, given[2].array.shape[1]));
        face.needed = number(4, face.corners.cols());
        const double* rectangle = given[5].array.as<double>() + 4 * f;
        face.rectangle = {{rectangle[0], rectangle[1]}, {rectangle[2], rectangle[3]}};
        face.sides = of(given[6], number(7, given[6].array.shape[1], 0));
        face.nodes = of(given[8], given[8].array.shape[1]);
        face.middle = face.nodes.rowwise().mean();
        face.reach = (face.corners.colwise() - face.middle).colwise().norm().maxCoeff();
        face.shortest = INFINITY;
        for (Index end = 0; end + 1 < face.sides.cols(); end += 2)
            face.shortest =
                std::min(face.shortest, (face.sides.col(end + 1) - face.sides.col(end)).norm());
        ++f;
    }
    for (Face& face : faces)
        for (const Face& other : faces) {
            if (&face == &other) continue;
            const Points outline = moved(other.base_from_face, other.rectangle.corners());
            const Points in_face = moved(face.base_from_face.inverse(), outline);
            if (!(in_face.row(2).minCoeff() < -BEFORE_M)) continue;
            const Pose face_from_base = other.base_from_face.inverse();
            face.hiders.push_back(
                {face_from_base, other.rectangle, moved(face_from_base, face.corners)});
        }
    return faces;
}

// One camera, and by which rules it finds a face: `steepest` the least cosine of the angle between
// a face's normal and the line of sight; the shortest side of a square has `least_px`; nothing is
// seen farther from the axis than `widest_rad`; and a metre across, a metre off, has at most
// `scale_px`.
struct Camera {
    Lens lens;
    Pose pose;
    Frame frame;
    double steepest, least_px, widest_rad, scale_px;

    // Whether a face turns its front to the camera, and may be near enough and in the picture.
    bool may_find(const Face& face, const Eigen::Vector3d& eye,
                  const Pose& camera_from_base) const {
        const Eigen::Vector3d sight = eye - face.middle;
        const double distance = sight.norm();
        if (!(-face.base_from_face.rotation.col(2).dot(sight) > steepest * distance)) return false;
        if (!(distance - face.reach <= scale_px * face.shortest / least_px)) return false;
        if (distance <= face.reach) return true;
        const double ahead =
            (camera_from_base.rotation * face.middle + camera_from_base.translation).z();
        return std::acos(std::clamp(ahead / distance, -1.0, 1.0)) -
                   std::asin(face.reach / distance) <
               widest_rad;
    }

    bool is_large(const Face& face, const Pose& camera_from_base) const {
        Eigen::Matrix<double, 2, 3> by_point;
        for (Index end = 0; end + 1 < face.sides.cols(); end += 2) {
            Eigen::Vector2d pixels[2];
            for (Index k = 0; k < 2; ++k) {
                const Eigen::Vector3d point = camera_from_base.rotation * face.sides.col(end + k) +
                                              camera_from_base.translation;
                if (!(point.z() > Frame::NEAREST)) return false;
                pixels[k] = lens.project(point, by_point);
            }
            if (!((pixels[1] - pixels[0]).norm() >= least_px)) return false;
        }
        return true;
    }

    // Notes which corners of a face are found at a pose; how many.
    Index found(const Face& face, const Pose& base, bool* is_seen) const {
        const Pose camera_from_base = pose.inverse().times(base);
        const Eigen::Vector3d eye = camera_from_base.inverse().translation;
        std::fill(is_seen, is_seen + face.corners.cols(), false);
        if (!may_find(face, eye, camera_from_base) || !is_large(face, camera_from_base)) return 0;
        std::vector<Eigen::Vector3d> eyes;
        for (const Hider& hider : face.hiders)
            eyes.push_back(hider.face_from_base.rotation * eye + hider.face_from_base.translation);
        Index count = 0;
        for (Index corner = 0; corner < face.corners.cols(); ++corner) {
            const Eigen::Vector3d point =
                camera_from_base.rotation * face.corners.col(corner) + camera_from_base.translation;
            is_seen[corner] = frame.shows(lens, point) && !face.is_hidden(corner, eyes);
            count += is_seen[corner];
        }
        if (count >= face.needed) return count;
        std::fill(is_seen, is_seen + face.corners.cols(), false);
        return 0;
    }

    // Adds the information of points that count as so many corners each, in square pixels.
    void inform(const Points& points, const bool* is_seen, double weight, const Pose& base,
                Eigen::Map<Matrix6d> information) const {
        for (Index n = 0; n < points.cols(); ++n) {
            if (is_seen && !is_seen[n]) continue;
            const ByPose by = projected(lens, base, points.col(n), pose).by_body;
            information.noalias() += weight * by.transpose() * by;
        }
    }
};

}  // namespace

// (lens (p,), limits (4,) as of tp_lens_sees, rules (4,), the camera's rotation (3, 3) and
// translation (3,), the base's rotations (n, 3, 3) and translations (n, 3), the faces as above,
// seen (n, f, c), information (n or 0, 6, 6)): which corners are found, and if it is wanted the
// information in them on the disturbance of the robot's pose, for corners of one pixel. A face that
// is found whole counts by its nodes.
TRIGPOINT_KERNEL(tp_sight) {
    const double* rules = arguments[2].array.as<double>();
    const Camera camera{
        {arguments[0].array.as<double>(), arguments[0].array.shape[0]},
        pose_at(arguments[3].array.as<double>(), arguments[4].array.as<double>(), 0),
        Frame(arguments[1].array.as<double>()),
        rules[0],
        rules[1],
        rules[2],
        rules[3]};
    const std::vector<Face> faces = faces_of(arguments + 7);
    const Array &seen = arguments[16].array, &information = arguments[17].array;
    const Index count = arguments[5].array.shape[0];
    if (information.shape[0] != 0 && information.shape[0] != count)
        throw std::invalid_argument("information of other poses");
    for (Index n = 0; n < count; ++n) {
        const Pose base =
            pose_at(arguments[5].array.as<double>(), arguments[6].array.as<double>(), n);
        for (std::size_t f = 0; f < faces.size(); ++f) {
            const Face& face = faces[f];
            bool* mine =
                seen.as<bool>() + (n * seen.shape[1] + static_cast<Index>(f)) * seen.shape[2];
            std::fill(mine, mine + seen.shape[2], false);
            const Index found = camera.found(face, base, mine);
            if (found == 0 || information.shape[0] == 0) continue;
            const Eigen::Map<Matrix6d> told(information.as<double>() + 36 * n);
            if (found == face.corners.cols())
                camera.inform(face.nodes, nullptr,
                              static_cast<double>(found) / static_cast<double>(face.nodes.cols()),
                              base, told);
            else
                camera.inform(face.corners, mine, 1, base, told);
        }
    }
    return 0;
}
