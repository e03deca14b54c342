// The corners of a batch of pictures: residuals and their derivatives by every unknown.
#include <Eigen/Core>
#include <stdexcept>

#include "border.hpp"
#include "fusion/projection.hpp"

using namespace trigpoint;

// (lens (p,), the camera's rotation (1, 3, 3) and translation (1, 3), the nodes' (n, …), those of
// the robot as it was seen (n, …), base_from_face (f, …), faces (n, k), points in their faces
// (n, k, 3), pixels (n, k, 2), weights (n, k), twists (n or 0, 6), since the epoch (n,), tangent
// (d,), has a lens, has faces, residuals (n, k, 2), Jacobian (n, k, 2 c), by the robot as it was
// seen (n, k, 12)). Columns: d of the node, 6 of the camera, p of its lens, 2 of its clock, 6 f of
// the faces, as far as they are wanted; arrays without columns are not.
TRIGPOINT_KERNEL(tp_corner_terms) {
    const auto numbers = [&](int which) { return arguments[which].array.as<double>(); };
    const Lens lens(numbers(0), arguments[0].array.shape[0]);
    const Pose camera = pose_at(numbers(1), numbers(2), 0);
    const Array &weights = arguments[12].array, &tangent = arguments[15].array;
    const Eigen::Index pictures = weights.shape[0], corners = weights.shape[1];
    const Eigen::Index faces = arguments[7].array.shape[0], d = tangent.shape[0];
    const bool has_clock = arguments[13].array.shape[0] > 0;
    const bool has_lens = arguments[16].whole != 0, has_faces = arguments[17].whole != 0;
    const Eigen::Index columns = arguments[19].array.shape[2] / 2;
    const bool is_by_seen = arguments[20].array.shape[2] > 0;
    const Eigen::Index wanted = d + 6 + (has_lens ? lens.parameters() : 0) + (has_clock ? 2 : 0) +
                                (has_faces ? 6 * faces : 0);
    if (columns != 0 && columns != wanted) throw std::invalid_argument("other columns are wanted");
    for (Eigen::Index i = 0; i < d; ++i)
        if (const auto axis = tangent.as<std::int64_t>()[i]; axis < 0 || axis > 5)
            throw std::out_of_range("a pose has six components");
    if (has_clock && arguments[13].array.shape[0] != pictures)
        throw std::invalid_argument("not every picture has a twist");
    if (is_by_seen && arguments[20].array.shape[2] != 12)
        throw std::invalid_argument("a pose has six components");
    Eigen::MatrixXd by_lens(2, lens.parameters());
    for (Eigen::Index n = 0; n < pictures; ++n) {
        const Pose node = pose_at(numbers(3), numbers(4), n),
                   seen = pose_at(numbers(5), numbers(6), n);
        Eigen::Vector3d speed = Eigen::Vector3d::Zero(), turning = speed;
        if (has_clock) {
            const double* twist = numbers(13) + 6 * n;
            speed = seen.rotation * Eigen::Map<const Eigen::Vector3d>(twist);
            turning = seen.rotation * Eigen::Map<const Eigen::Vector3d>(twist + 3);
        }
        for (Eigen::Index k = 0; k < corners; ++k) {
            const Eigen::Index at = n * corners + k;
            const double weight = numbers(12)[at];
            const std::int64_t face = arguments[9].array.as<std::int64_t>()[at];
            if (face < 0 || face >= faces) throw std::out_of_range("no such face");
            const Pose base_from_face = pose_at(numbers(7), numbers(8), face);
            const Eigen::Vector3d in_face =
                base_from_face.rotation * Eigen::Map<const Eigen::Vector3d>(numbers(10) + 3 * at);
            const Eigen::Vector3d in_seen = seen.rotation * (in_face + base_from_face.translation);
            const Eigen::Vector3d arm = in_seen + (seen.translation - node.translation);
            const Eigen::Vector3d from_camera = arm + (node.translation - camera.translation);
            Eigen::Vector3d optical = camera.rotation.transpose() * from_camera;
            if (!(optical.z() > NEAREST_M)) optical.z() = NEAREST_M;
            if (!(weight > 0)) optical.z() = 1;
            Eigen::Matrix<double, 2, 3> by_optical;
            const Eigen::Vector2d pixel = lens.project(optical, by_optical);
            Eigen::Map<Eigen::Vector2d>(numbers(18) + 2 * at) =
                weight * (pixel - Eigen::Map<const Eigen::Vector2d>(numbers(11) + 2 * at));
            const Eigen::Matrix<double, 2, 3> by_map =
                (weight * by_optical) * camera.rotation.transpose();
            if (is_by_seen)
                Eigen::Map<ByPose>(numbers(20) + 12 * at) = by_disturbance(by_map, in_seen);
            if (columns == 0) continue;
            Eigen::Map<Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>> by(
                numbers(19) + 2 * columns * at, 2, columns);
            const ByPose by_node = by_disturbance(by_map, arm);
            for (Eigen::Index i = 0; i < d; ++i)
                by.col(i) = by_node.col(tangent.as<std::int64_t>()[i]);
            by.middleCols<6>(d) = by_disturbance(-by_map, from_camera);
            Eigen::Index next = d + 6;
            if (has_lens) {
                lens.by_parameters(optical, by_lens);
                by.middleCols(next, lens.parameters()) = weight * by_lens;
                next += lens.parameters();
            }
            if (has_clock) {
                const Eigen::Vector2d by_time = -by_map * (speed + turning.cross(in_seen));
                by.col(next) = by_time;
                by.col(next + 1) = by_time * numbers(14)[n];
                next += 2;
            }
            if (has_faces) {
                by.rightCols(columns - next).setZero();
                by.middleCols<6>(next + 6 * face) = by_disturbance(by_map * seen.rotation, in_face);
            }
        }
    }
    return 0;
}
