// Views of a target, every way to read them, and how well each fits; see `fusion/reading`.
#pragma once

#include <limits>
#include <utility>
#include <vector>

#include "border.hpp"
#include "fusion/pose_fitting.hpp"

namespace trigpoint {

// The face that a view shows, and whether it is read from its other end.
struct Reading {
    Eigen::Index face;
    bool is_turned;
};

// A target as an opaque solid in the robot's base frame; see `views.body_tables`.
class Body {
public:
    using Index = Eigen::Index;
    // Corners in their faces (f, c, 3), how many of them each has (f,), base_from_face (f, 12), the
    // patterns' lowest and highest x and y (f, 4).
    static constexpr int ARGUMENTS = 4;

    // Throws std::invalid_argument where a face has more corners than are given.
    explicit Body(const Argument* arguments);

    Index faces() const { return static_cast<Index>(base_from_face_.size()); }
    const Pose& base_from_face(Index face) const { return base_from_face_[at(face)]; }
    const Pose& face_from_base(Index face) const { return face_from_base_[at(face)]; }
    // A corner in its face; throws std::out_of_range where there is none.
    Eigen::Vector3d corner(const Reading& reading, std::int64_t id) const;
    // The frame of a face as its corners are named when it is read from its other end.
    Pose turned(Index face) const;
    // Whether an eye in the base frame is in front of a face; and whether other faces hide no more
    // than half of its points from it.
    bool is_in_front(Index face, const Eigen::Vector3d& eye) const;
    bool is_open(Index face, const std::vector<Eigen::Vector3d>& points,
                 const Eigen::Vector3d& eye) const;

private:
    const Array &corners_, &counts_, &outlines_;
    std::vector<Pose> base_from_face_, face_from_base_;

    static std::size_t at(Index index) { return static_cast<std::size_t>(index); }
    Index count(Index face) const { return counts_.as<std::int64_t>()[face]; }
    bool goes_through(Index face, const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;
};

// Views of one robot.
class Views {
public:
    using Index = Eigen::Index;
    // First corner, corners, first reading and readings of each (v, 4), its sigma (v,), twist of
    // the robot then (v, 6); corners' ids (k,), pixels (k, 2), exposed so long after (k,); readings
    // as face and whether it is turned (r, 2).
    static constexpr int ARGUMENTS = 7;

    // Throws std::invalid_argument where a view is of corners, readings or faces that are none.
    Views(const Argument* arguments, const Body& body);

    Index count() const { return arguments_[0].array.shape[0]; }
    Index first_corner(Index view) const { return row(view)[0]; }
    Index corners(Index view) const { return row(view)[1]; }
    Index first_reading(Index view) const { return row(view)[2]; }
    Index readings(Index view) const { return row(view)[3]; }
    Reading reading(Index view, Index number) const;
    double sigma(Index view) const { return arguments_[1].array.as<double>()[view]; }
    Pixels pixels(Index view) const {
        return {arguments_[4].array.as<double>() + 2 * first_corner(view), corners(view), 2};
    }
    std::int64_t id(Index view, Index k) const {
        return arguments_[3].array.as<std::int64_t>()[first_corner(view) + k];
    }
    // A corner in its face, as it was when its row was exposed.
    Eigen::Vector3d point(Index view, Index k, const Reading& reading) const;

    // RMS of a coordinate (pixels) where the target is at a pose; infinite where it cannot be seen.
    double rms_px(Index view, const Reading& reading, const Lens& lens,
                  const Pose& camera_from_base) const;
    // The number of the reading of least RMS, and that, each face being where `pose` puts the
    // target for it.
    template <class PoseOf>
    std::pair<Index, double> best(Index view, const Lens& lens, PoseOf&& pose) const {
        std::pair<Index, double> found{0, std::numeric_limits<double>::infinity()};
        for (Index number = 0; number < readings(view); ++number) {
            const Reading each = reading(view, number);
            const double rms = rms_px(view, each, lens, pose(each.face));
            if (rms < found.second) found = {number, rms};
        }
        return found;
    }

private:
    const Argument* arguments_;
    const Body& body_;

    const std::int64_t* row(Index view) const {
        return arguments_[0].array.as<std::int64_t>() + 4 * view;
    }
    std::vector<Index> outermost(Index view) const;
};

}  // namespace trigpoint
