// Where the search for the minimum of a pose graph begins. A tie may be the first to constrain a
// part of a robot's path: the path of a robot that may have started anywhere, or what follows a
// lift. From metres away Gauss-Newton takes many steps, so such a part is first moved rigidly to
// where the tie puts it.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

using Index = Eigen::Index;
using Places = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 12, Eigen::RowMajor>>;

// A part of a path that is off by less than this (m, rad) is left to Gauss-Newton.
constexpr double FAR_OFF = 0.1;

// Where a robot in the plane stands that would be there.
Pose on_the_floor(const Pose& there) {
    const double heading = std::atan2(there.rotation(1, 0), there.rotation(0, 0));
    return {exp({0, 0, heading}), {there.translation.x(), there.translation.y(), 0}};
}

}  // namespace

// (poses (n, 12), of each whether it is known from before, or begins as it is (n, 2), [parts] first
// and end, whether that is held, whether in the plane (r, 4), [ties] ends (k, 4), motion (k, 12),
// whether each is new (k,)): 0; see `minimum.initial_poses`.
TRIGPOINT_KERNEL(tp_graph_start) {
    Places poses = arguments[0].array.rows<12>();
    const Array &parts = arguments[2].array, &ties = arguments[3].array;
    const auto* begun = arguments[1].array.as<std::int64_t>();
    const auto* is_new = arguments[5].array.as<std::int64_t>();
    std::vector<bool> is_placed;
    for (Index i = 0; i < poses.rows(); ++i) is_placed.push_back(begun[2 * i] != 0);
    const auto end_of = [&](Index k, int side) {
        const Index pose = ties.as<std::int64_t>()[4 * k + side];
        if (pose < 0 || pose >= poses.rows()) throw std::invalid_argument("a tie of none");
        return pose;
    };
    const auto seen = [&](Index k) { return pose_at(arguments[4].array.as<double>() + 12 * k); };
    const auto pose = [&](Index i) { return pose_at(&poses(i, 0)); };
    for (Index p = 0; p < parts.shape[0]; ++p) {
        const std::int64_t* part = parts.as<std::int64_t>() + 4 * p;
        if (part[0] < 0 || part[1] > poses.rows()) throw std::invalid_argument("a part of none");
        std::vector<Index> mine;
        for (Index k = 0; k < ties.shape[0]; ++k)
            if (end_of(k, 0) >= part[0] && end_of(k, 0) < part[1]) mine.push_back(k);
        const auto first = std::find_if(mine.begin(), mine.end(),
                                        [&](Index k) { return is_placed[end_of(k, 1)]; });
        bool is_moved = std::any_of(mine.begin(), mine.end(), [&](Index k) { return is_new[k]; }) &&
                        !part[2] && first != mine.end();
        if (is_moved) {
            const Pose here = pose(end_of(*first, 0));
            Pose there = pose(end_of(*first, 1)).times(seen(*first).inverse());
            if (part[3]) there = on_the_floor(there);
            is_moved = there.difference(here).cwiseAbs().maxCoeff() > FAR_OFF;
            const Pose shift = there.times(here.inverse());
            for (Index i = part[0]; is_moved && i < part[1]; ++i)
                put_pose(shift.times(pose(i)), &poses(i, 0));
        }
        for (const Index k : mine) {
            const Index camera = end_of(k, 1);
            if (!is_placed[camera] && (is_moved || !begun[2 * camera + 1]))
                put_pose(pose(end_of(k, 0)).times(seen(k)), &poses(camera, 0));
            is_placed[camera] = true;
        }
    }
    return 0;
}
