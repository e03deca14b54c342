// Both poses of a plane from one picture, and which of its corners are on one plane.
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/pose_fitting.hpp"

using namespace trigpoint;

namespace {

constexpr Eigen::Index LEAST_CORNERS = 4;
// The second extent of what lies on a line, at most (m).
constexpr double LINE_M = 1e-6;
// A direction this near to the optical axis needs no turn.
constexpr double ON_AXIS = 1e-12;
// How sure it is that one sample had no wild corner in it, and how many samples are drawn at most.
constexpr double CONFIDENCE = 0.9999;
constexpr int MOST_SAMPLES = 2000;

using Plane = Eigen::Matrix<double, Eigen::Dynamic, 2>;

// Moves and scales points to mean 0 and mean square 2 (Hartley, 1997): their frame as a matrix.
Eigen::Matrix3d conditioned(Plane& points) {
    const Eigen::RowVector2d middle = points.colwise().mean();
    points.rowwise() -= middle;
    const double mean_square = points.rowwise().squaredNorm().mean();
    const double scale = mean_square > 0 ? std::sqrt(2 / mean_square) : 1;
    points *= scale;
    Eigen::Matrix3d frame;
    frame << scale, 0, -scale * middle.x(), 0, scale, -scale * middle.y(), 0, 0, 1;
    return frame;
}

// The homography from plane to picture, by the direct linear transformation.
Eigen::Matrix3d homography(Plane from, Plane to) {
    const Eigen::Matrix3d before = conditioned(from), after = conditioned(to);
    Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
    for (Eigen::Index k = 0; k < from.rows(); ++k) {
        const Eigen::RowVector3d point(from(k, 0), from(k, 1), 1);
        Eigen::Matrix<double, 2, 9> rows = Eigen::Matrix<double, 2, 9>::Zero();
        rows.block<1, 3>(0, 0) = rows.block<1, 3>(1, 3) = point;
        rows.block<1, 3>(0, 6) = -to(k, 0) * point;
        rows.block<1, 3>(1, 6) = -to(k, 1) * point;
        normal.noalias() += rows.transpose() * rows;
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> parts(normal);
    const Eigen::Matrix<double, 9, 1> least = parts.eigenvectors().col(0);
    Eigen::Matrix3d found;
    found << least.segment<3>(0).transpose(), least.segment<3>(3).transpose(),
        least.segment<3>(6).transpose();
    return after.inverse() * found * before;
}

// The rotation that takes the optical axis to the direction of an image point.
Eigen::Matrix3d turned_to(const Eigen::Vector2d& image) {
    const double aside = image.norm();
    if (aside < ON_AXIS) return Eigen::Matrix3d::Identity();
    const Eigen::Vector3d axis(-image.y() / aside, image.x() / aside, 0);
    return Eigen::AngleAxisd(std::atan(aside), axis).toRotationMatrix();
}

// Both rotations of a plane whose homography at its origin has the value `image` and the derivative
// `slope` (Collins and Bartoli, «Infinitesimal plane-based pose estimation», 2014).
std::array<Eigen::Matrix3d, 2> rotations_of(const Eigen::Vector2d& image,
                                            const Eigen::Matrix2d& slope) {
    const Eigen::Matrix3d turn = turned_to(image);
    Eigen::Matrix<double, 2, 3> sight;
    sight << 1, 0, -image.x(), 0, 1, -image.y();
    const Eigen::Matrix2d flat = (sight * turn.leftCols<2>()).inverse() * slope;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> parts(flat.transpose() * flat);
    const Eigen::Matrix2d upper = flat / std::sqrt(parts.eigenvalues()(1));
    Eigen::RowVector2d lower = (1 - upper.colwise().squaredNorm().array()).max(0.0).sqrt();
    if (upper.col(0).dot(upper.col(1)) > 0) lower(1) = -lower(1);
    std::array<Eigen::Matrix3d, 2> both;
    for (int which = 0; which < 2; ++which) {
        Eigen::Matrix3d rotation;
        rotation.topLeftCorner<2, 2>() = upper;
        rotation.bottomLeftCorner<1, 2>() = which ? -lower : lower;
        rotation.col(2) = rotation.col(0).cross(rotation.col(1));
        both[static_cast<std::size_t>(which)] = turn * rotation;
    }
    return both;
}

// Where a plane of this rotation is, by least squares.
Eigen::Vector3d translation_of(const Eigen::Matrix3d& rotation, const Plane& plane,
                               const Plane& image) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d pull = Eigen::Vector3d::Zero();
    for (Eigen::Index k = 0; k < plane.rows(); ++k) {
        Eigen::Matrix<double, 2, 3> sight;
        sight << 1, 0, -image(k, 0), 0, 1, -image(k, 1);
        const Eigen::Vector3d arm = rotation.leftCols<2>() * plane.row(k).transpose();
        normal.noalias() += sight.transpose() * sight;
        pull.noalias() -= sight.transpose() * (sight * arm);
    }
    return normal.partialPivLu().solve(pull);
}

using Mask = Eigen::Array<bool, Eigen::Dynamic, 1>;

// Which points a homography takes to within a limit of where they are.
Mask near(const Eigen::Matrix3d& h, const Plane& from, const Plane& to, double limit) {
    const Eigen::Matrix<double, Eigen::Dynamic, 3> there =
        from.rowwise().homogeneous() * h.transpose();
    const Plane apart = there.rowwise().hnormalized() - to;
    return apart.rowwise().squaredNorm().array() <= limit * limit;
}

Plane chosen(const Plane& points, const std::vector<Eigen::Index>& rows) {
    Plane some(rows.size(), 2);
    for (std::size_t i = 0; i < rows.size(); ++i)
        some.row(static_cast<Eigen::Index>(i)) = points.row(rows[i]);
    return some;
}

// The same by the homography of those that are near one, as long as that brings more.
Mask grown(Mask found, const Plane& from, const Plane& to, double limit) {
    while (found.count() >= LEAST_CORNERS) {
        std::vector<Eigen::Index> rows;
        for (Eigen::Index k = 0; k < found.size(); ++k)
            if (found(k)) rows.push_back(k);
        const Mask more = near(homography(chosen(from, rows), chosen(to, rows)), from, to, limit);
        if (more.count() <= found.count()) break;
        found = more;
    }
    return found;
}

// Which points the homography that fits most of them takes to within a limit of where they are; all
// where there is none. Begins with those of four, drawn at random (RANSAC, locally optimised: Chum,
// Matas and Kittler, 2003).
Mask on_one_plane(const Plane& from, const Plane& to, double limit) {
    const Eigen::Index count = from.rows();
    std::minstd_rand random;  // the same draws on every machine
    Mask best = Mask::Constant(count, false);
    double needed = MOST_SAMPLES;
    for (int sample = 0; sample < needed; ++sample) {
        std::vector<Eigen::Index> rows;
        while (rows.size() < static_cast<std::size_t>(LEAST_CORNERS)) {
            const auto row = static_cast<Eigen::Index>(random()) % count;
            if (std::find(rows.begin(), rows.end(), row) == rows.end()) rows.push_back(row);
        }
        // Four noisy corners hardly tell where those far from them are.
        const Mask found =
            grown(near(homography(chosen(from, rows), chosen(to, rows)), from, to, limit), from, to,
                  limit);
        if (found.count() <= best.count()) continue;
        best = found;
        const double share = static_cast<double>(best.count()) / static_cast<double>(count);
        const double all = std::pow(share, LEAST_CORNERS);
        if (all >= 1) break;
        needed = std::min<double>(MOST_SAMPLES, std::log(1 - CONFIDENCE) / std::log1p(-all));
    }
    return best.count() < LEAST_CORNERS ? Mask::Constant(count, true) : best;
}

bool are_on_a_line(const Plane& plane) {
    const Plane apart = plane.rowwise() - plane.row(0);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> parts(apart.transpose() * apart);
    return !(parts.eigenvalues()(0) > LINE_M * LINE_M);
}

}  // namespace

std::size_t trigpoint::plane_poses(const Lens& lens, const Points3& points, const Pixels& pixels,
                                   double sigma, std::array<Fit, 2>& found) {
    const Eigen::Index count = points.rows();
    const Plane plane = points.leftCols<2>();
    if (count < LEAST_CORNERS || !plane.allFinite() || are_on_a_line(plane)) return 0;
    Plane image(count, 2);
    for (Eigen::Index k = 0; k < count; ++k) {
        const Eigen::Vector2d direction = lens.direction(pixels.row(k).transpose());
        if (!direction.allFinite()) return 0;
        image.row(k) = direction.transpose();
    }
    const Eigen::RowVector2d middle = plane.colwise().mean();
    const Plane centred = plane.rowwise() - middle;
    Eigen::Matrix3d h = homography(centred, image);
    h /= h(2, 2);
    if (!h.allFinite()) return 0;
    const Eigen::Vector2d centre = h.topRightCorner<2, 1>();
    const Eigen::Matrix2d slope = h.topLeftCorner<2, 2>() - centre * h.bottomLeftCorner<1, 2>();
    const Eigen::VectorXd weights = Eigen::VectorXd::Constant(count, 1 / sigma);
    std::size_t kept = 0;
    for (const Eigen::Matrix3d& rotation : rotations_of(centre, slope)) {
        if (!rotation.allFinite()) continue;
        Fit fit{{rotation, translation_of(rotation, centred, image)}, 0};
        fit.pose.translation -= rotation.leftCols<2>() * middle.transpose();
        fit.rms = refine(lens, fit.pose, points, pixels, Weights(weights.data(), count));
        const Eigen::Vector3d at = fit.pose.rotation.leftCols<2>() * middle.transpose();
        // z points away from whoever sees the plane's front.
        if (std::isfinite(fit.rms) && fit.pose.rotation.col(2).dot(at + fit.pose.translation) > 0)
            found[kept++] = fit;
    }
    if (kept == 2 && found[1].rms < found[0].rms) std::swap(found[0], found[1]);
    return kept;
}

// (lens (p,), points (n, 3) with z = 0, pixels (n, 2), sigma, rotations (2, 3, 3), translations
// (2, 3), rms (2,)): how many poses fit, best first; see `planar_poses`.
TRIGPOINT_KERNEL(tp_plane_poses) {
    const Lens lens(arguments[0].array.as<double>(), arguments[0].array.shape[0]);
    const Eigen::Index count = arguments[1].array.shape[0];
    std::array<Fit, 2> found;
    const std::size_t kept =
        plane_poses(lens, Points3(arguments[1].array.as<double>(), count, 3),
                    Pixels(arguments[2].array.as<double>(), count, 2), arguments[3].number, found);
    for (std::size_t i = 0; i < kept; ++i) {
        const auto row = static_cast<Eigen::Index>(i);
        put_pose(found[i].pose, arguments[4].array.as<double>(), arguments[5].array.as<double>(),
                 row);
        arguments[6].array.as<double>()[row] = found[i].rms;
    }
    return static_cast<std::int64_t>(kept);
}

// (points (n, 2) of a plane, where they are seen (n, 2), limit, which of them fit one plane (n,)):
// how many.
TRIGPOINT_KERNEL(tp_on_one_plane) {
    const Plane from = arguments[0].array.rows<2>(), to = arguments[1].array.rows<2>();
    if (from.rows() < LEAST_CORNERS || !from.allFinite() || !to.allFinite())
        throw std::invalid_argument("too few points, or some that are not finite");
    const Mask kept = on_one_plane(from, to, arguments[2].number);
    std::copy(kept.begin(), kept.end(), arguments[3].array.as<bool>());
    return kept.count();
}
