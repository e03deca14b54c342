// What Python asks of projections.
#include "fusion/projection.hpp"

#include "border.hpp"

using namespace trigpoint;

// (lens (p,), rotations (b, 3, 3), translations (b, 3), points (b, k, 3), the camera's rotation
// (3, 3) and translation (3,), pixels (b, k, 2), by body (b, k, 12), is ahead (b, k)): all corners.
TRIGPOINT_KERNEL(tp_projected) {
    const Lens lens(arguments[0].array.as<double>(), arguments[0].array.shape[0]);
    const Array& points = arguments[3].array;
    const Pose camera =
        pose_at(arguments[4].array.as<double>(), arguments[5].array.as<double>(), 0);
    for (Eigen::Index b = 0; b < points.shape[0]; ++b) {
        const Pose body =
            pose_at(arguments[1].array.as<double>(), arguments[2].array.as<double>(), b);
        for (Eigen::Index k = 0; k < points.shape[1]; ++k) {
            const Eigen::Index at = b * points.shape[1] + k;
            const Projected found =
                projected(lens, body,
                          Eigen::Map<const Eigen::Vector3d>(points.as<double>() + 3 * at), camera);
            Eigen::Map<Eigen::Vector2d>(arguments[6].array.as<double>() + 2 * at) = found.pixel;
            Eigen::Map<ByPose>(arguments[7].array.as<double>() + 12 * at) = found.by_body;
            arguments[8].array.as<bool>()[at] = found.is_ahead;
        }
    }
    return 0;
}
