#include "fusion/reading.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace trigpoint {

namespace {

using Eigen::Index;
using Eigen::Vector3d;

// Faces are not mounted exactly where the target file says, so a corner at the edge of what another
// face hides may be seen; a view most of whose corners are hidden can't.
constexpr double HIDDEN_SHARE = 0.5;
// Shares of the way from an eye to a corner that are beside its ends.
constexpr double BESIDE = 1e-3;
// What a camera sees is farther from it than this.
constexpr double AHEAD_M = 1e-3;

void require(bool is_so, const char* what) {
    if (!is_so) throw std::invalid_argument(what);
}

}  // namespace

Body::Body(const Argument* arguments)
    : corners_(arguments[0].array), counts_(arguments[1].array), outlines_(arguments[3].array) {
    for (Index f = 0; f < counts_.shape[0]; ++f) {
        require(count(f) >= 0 && count(f) <= corners_.shape[1], "a face of corners that are none");
        base_from_face_.push_back(pose_at(arguments[2].array.as<double>() + 12 * f));
        face_from_base_.push_back(base_from_face_.back().inverse());
    }
}

Vector3d Body::corner(const Reading& reading, std::int64_t id) const {
    const Index all = count(reading.face);
    if (id < 0 || id >= all) throw std::out_of_range("a face has no such corner");
    const Index row = reading.face * corners_.shape[1] + (reading.is_turned ? all - 1 - id : id);
    return Eigen::Map<const Vector3d>(corners_.as<double>() + 3 * row);
}

Pose Body::turned(Index face) const {
    const Eigen::Matrix3d half = Vector3d(-1, -1, 1).asDiagonal();
    return base_from_face(face).times({half, corner({face, true}, 0)});
}

bool Body::is_in_front(Index face, const Vector3d& eye) const {
    return face_from_base(face).rotation.row(2).dot(eye - base_from_face(face).translation) < 0;
}

bool Body::is_open(Index face, const std::vector<Vector3d>& points, const Vector3d& eye) const {
    std::vector<bool> is_hidden(points.size());
    for (Index other = 0; other < faces(); ++other) {
        if (other == face) continue;
        const Pose& in_other = face_from_base(other);
        const auto inside = [&](const Vector3d& p) -> Vector3d {
            return in_other.rotation * p + in_other.translation;
        };
        for (std::size_t k = 0; k < points.size(); ++k)
            if (goes_through(other, inside(eye), inside(points[k]))) is_hidden[k] = true;
    }
    const auto hidden = std::count(is_hidden.begin(), is_hidden.end(), true);
    return static_cast<double>(hidden) <= HIDDEN_SHARE * static_cast<double>(points.size());
}

bool Body::goes_through(Index face, const Vector3d& from, const Vector3d& to) const {
    const double share = from.z() / (from.z() - to.z());
    if (!(share > BESIDE && share < 1 - BESIDE)) return false;
    const double* outline = outlines_.as<double>() + 4 * face;
    for (Index axis = 0; axis < 2; ++axis) {
        const double crossing = from[axis] + share * (to[axis] - from[axis]);
        if (!(crossing > outline[axis] && crossing < outline[axis + 2])) return false;
    }
    return true;
}

Views::Views(const Argument* arguments, const Body& body) : arguments_(arguments), body_(body) {
    const Index corners = arguments[3].array.shape[0], all = arguments[6].array.shape[0];
    for (Index v = 0; v < count(); ++v) {
        const std::int64_t* view = row(v);
        require(view[0] >= 0 && view[1] >= 0 && view[1] <= corners && view[0] <= corners - view[1],
                "a view of corners that are none");
        require(view[2] >= 0 && view[3] > 0 && view[3] <= all && view[2] <= all - view[3],
                "a view of readings that are none");
    }
    for (Index r = 0; r < all; ++r) {
        const std::int64_t face = arguments[6].array.as<std::int64_t>()[2 * r];
        require(face >= 0 && face < body.faces(), "a reading of a face that is none");
    }
}

Reading Views::reading(Index view, Index number) const {
    const std::int64_t* found =
        arguments_[6].array.as<std::int64_t>() + 2 * (first_reading(view) + number);
    return {found[0], found[1] != 0};
}

Vector3d Views::point(Index view, Index k, const Reading& reading) const {
    const Vector3d still = body_.corner(reading, id(view, k));
    const double after_s = arguments_[5].array.as<double>()[first_corner(view) + k];
    if (after_s == 0) return still;
    const double* twist = arguments_[2].array.as<double>() + 6 * view;
    const Pose& face = body_.base_from_face(reading.face);
    const Vector3d in_base = face.rotation * still + face.translation;
    const Vector3d speed =
        Eigen::Map<const Vector3d>(twist) + Eigen::Map<const Vector3d>(twist + 3).cross(in_base);
    return still + face.rotation.transpose() * (after_s * speed);
}

double Views::rms_px(Index view, const Reading& reading, const Lens& lens,
                     const Pose& camera_from_base) const {
    constexpr double NONE = std::numeric_limits<double>::infinity();
    const Index all = corners(view);
    const Vector3d eye = camera_from_base.inverse().translation;
    if (all == 0 || !body_.is_in_front(reading.face, eye)) return NONE;
    const Pose& face = body_.base_from_face(reading.face);
    const auto in_base = [&](Index k) -> Vector3d {
        return face.rotation * point(view, k, reading) + face.translation;
    };
    std::vector<Vector3d> outer;
    for (const Index k : outermost(view)) outer.push_back(in_base(k));
    if (!body_.is_open(reading.face, outer, eye)) return NONE;
    const Pixels seen = pixels(view);
    Eigen::Matrix<double, 2, 3> by_point;
    double squares = 0;
    for (Index k = 0; k < all; ++k) {
        const Vector3d optical =
            camera_from_base.rotation * in_base(k) + camera_from_base.translation;
        if (!(optical.z() > AHEAD_M)) return NONE;
        squares += (lens.project(optical, by_point) - seen.row(k).transpose()).squaredNorm();
    }
    const double rms = std::sqrt(squares / static_cast<double>(2 * all));
    return std::isfinite(rms) ? rms : NONE;
}

// The corners that reach furthest in four directions, each once.
std::vector<Index> Views::outermost(Index view) const {
    const Pixels seen = pixels(view);
    std::vector<Index> found;
    for (const double across : {1.0, -1.0})
        for (const double sign : {1.0, -1.0}) {
            Index least = 0;
            (sign * (seen.col(0) + across * seen.col(1))).minCoeff(&least);
            found.push_back(least);
        }
    std::sort(found.begin(), found.end());
    found.erase(std::unique(found.begin(), found.end()), found.end());
    return found;
}

}  // namespace trigpoint

using namespace trigpoint;

// (lens (p,), a body, views, the target as each is seen (v, 12), the number of its best reading
// (v,), the RMS of every reading (r,)): 0; RMS of what cannot be seen is infinite.
TRIGPOINT_KERNEL(tp_readings) {
    const Lens lens(arguments[0].array.as<double>(), arguments[0].array.shape[0]);
    const Body body(arguments + 1);
    const Views views(arguments + 1 + Body::ARGUMENTS, body);
    const Argument* found = arguments + 1 + Body::ARGUMENTS + Views::ARGUMENTS;
    for (Eigen::Index v = 0; v < views.count(); ++v) {
        const Pose camera_from_base = pose_at(found[0].array.as<double>() + 12 * v);
        double* rms = found[2].array.as<double>() + views.first_reading(v);
        for (Eigen::Index r = 0; r < views.readings(v); ++r)
            rms[r] = views.rms_px(v, views.reading(v, r), lens, camera_from_base);
        found[1].array.as<std::int64_t>()[v] = std::min_element(rms, rms + views.readings(v)) - rms;
    }
    return 0;
}
