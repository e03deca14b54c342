#include <algorithm>
#include <cmath>
#include <limits>

#include "registration/plane_fitting.hpp"

namespace trigpoint {
namespace {

constexpr double LEAST_WILD_PX = 0.7, WILD_SIGMAS = 5.0;
// Of the spacing: corners that scatter by so much are not those of one flat face.
constexpr double SCATTER_SHARE = 0.1;
// Corners that are so far off even before a lens is fitted are not worth the fit.
constexpr double CHAOS_SHARE = 0.4;
constexpr double RAYLEIGH_MEDIAN = 1.18;

// Median distance of a pixel to the nearest other one; 0 for fewer than two.
double spacing_of(const PointsIn& pixels) {
    if (pixels.rows() < 2) return 0;
    std::vector<double> nearest;
    for (Eigen::Index i = 0; i < pixels.rows(); ++i) {
        double least = std::numeric_limits<double>::infinity();
        for (Eigen::Index j = 0; j < pixels.rows(); ++j)
            if (j != i) least = std::min(least, (pixels.row(i) - pixels.row(j)).squaredNorm());
        nearest.push_back(least);
    }
    return std::sqrt(median(nearest));
}

}  // namespace

std::optional<PlanarFit> sound_corners(const PointsIn& points, const PointsIn& pixels,
                                       const PlanarFit& start, bool has_start,
                                       const SoundLimits& limits, std::vector<char>& keep) {
    const Eigen::Index n = points.rows();
    keep.assign(static_cast<std::size_t>(n), 0);
    if (n < 4 || !points.allFinite() || !pixels.allFinite()) return std::nullopt;
    const double spacing = spacing_of(pixels);
    std::vector<double> least, distances(static_cast<std::size_t>(n)), some;
    for (const double share : limits.least_share)
        least.push_back(std::max(limits.least_px, share * spacing));
    std::optional<PlanarFit> fit = start;
    if (!has_start) fit = fit_plane(points, pixels, start, false, false);
    if (!fit) return std::nullopt;
    const auto measure = [&] {
        for (Eigen::Index i = 0; i < n; ++i)
            distances[i] = fit->residual(points.row(i), pixels.row(i));
    };
    measure();
    some = distances;
    if (!(median(some) <= std::max(2.0, CHAOS_SHARE * spacing))) return std::nullopt;
    const double enough =
        limits.enough_px >= 0 ? limits.enough_px : *std::min_element(least.begin(), least.end());
    keep.assign(static_cast<std::size_t>(n), 1);
    Points kept_points(n, 2), kept_pixels(n, 2);
    for (;;) {
        Eigen::Index count = 0;
        for (Eigen::Index i = 0; i < n; ++i) {
            if (!keep[i]) continue;
            kept_points.row(count) = points.row(i), kept_pixels.row(count++) = pixels.row(i);
        }
        if (count < 4) break;
        fit =
            settled_fit(kept_points.topRows(count), kept_pixels.topRows(count), *fit, true, enough);
        if (!fit) break;
        measure();
        some.clear();
        for (Eigen::Index i = 0; i < n; ++i)
            if (keep[i]) some.push_back(distances[i]);
        const double usual = median(some) / RAYLEIGH_MEDIAN;
        if (!(usual <= std::max(LEAST_WILD_PX, SCATTER_SHARE * spacing))) break;
        double worst = 0;
        const auto beyond = [&](Eigen::Index i) {
            return distances[i] / std::max(least[i], WILD_SIGMAS * usual);
        };
        for (Eigen::Index i = 0; i < n; ++i)
            if (keep[i]) worst = std::max(worst, beyond(i));
        if (worst <= 1) return fit;
        for (Eigen::Index i = 0; i < n; ++i)
            keep[i] = keep[i] && beyond(i) < std::max(1.0, 0.7 * worst);
    }
    keep.assign(static_cast<std::size_t>(n), 0);
    return std::nullopt;
}

}  // namespace trigpoint
