// From about where a face lies to its corners: registered, sorted out, with their sigma; and what
// Python asks of it.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "border.hpp"
#include "registration/registration.hpp"

namespace trigpoint {
namespace {

constexpr std::size_t LEAST_CORNERS = 4;
// What a drawing on half pixels and grey values in whole numbers leave: of rendered faces without
// any noise the best one was off by so much, RMS.
constexpr double LEAST_SIGMA_PX = 0.003;
// Registered corners that lie this far off their plane are not believed: pixels, and share of the
// spacing; more is allowed where all scatter. A corner that looks as printed is where the paper has
// it, which is not flat to better than the second share; one with something before it may be off.
constexpr double LEAST_WILD_PX = 0.1, LEAST_WILD_SHARE = 0.01, WHOLE_WILD_SHARE = 0.06;
// Corners that are so near their plane need no lens of their own, pixels.
constexpr double ENOUGH_PX = 0.03;
// What the picture's noise says of a face's sigma is worth so many squares of what its corners
// scatter about their plane: of rendered faces its variance is up to double or half of the true
// one, as what the drawing leaves counts as noise. It is worth less where scatter exceeds it by
// more than this multiple: no board is quite flat.
constexpr double NOISE_WORTH = 4.0, MOST_EXCESS = 4.0;
constexpr double MARGIN_PX = 2.0;
// Of a corner whose gradients are asked, how far from its start it may come.
constexpr double SURE_PX = 2.0;
// Of a corner of a face that shows too few of them for a plane.
constexpr double FEW_CORNERS_SIGMA_PX = 0.1;

bool is_in_view(const PlanarFit& fit, const Eigen::Vector2d& point, double width, double height) {
    const Eigen::Vector2d pixel = fit.project(point);
    return pixel.minCoeff() > MARGIN_PX && pixel.x() < width - 1 - MARGIN_PX &&
           pixel.y() < height - 1 - MARGIN_PX;
}

// With the corners that the search saw and that do not look as printed: where light clips or a
// reflection ends. They are where the gradients about them meet, if that is near where they were
// seen; they count as having something before them. Where most are lost, the face itself is not as
// printed.
void ask_gradients(const Grey& grey, const std::vector<Eigen::Vector2d>& near,
                   Registration& found) {
    std::vector<std::size_t> lost;
    for (std::size_t i = 0; i < near.size(); ++i)
        if (!found.is_clear[i] && near[i].allFinite()) lost.push_back(i);
    if (2 * lost.size() > near.size()) return;
    for (const std::size_t i : lost) {
        found.pixels[i] = where_gradients_meet(grey, near[i]);
        found.is_clear[i] = (found.pixels[i] - near[i]).norm() < SURE_PX;
        found.is_whole[i] = false;
        found.sigma[i] = FEW_CORNERS_SIGMA_PX;
    }
}

// Standard deviation of a coordinate: what is expected by the picture's noise, and what is seen.
// The posterior of a variance under a scaled inverse chi-squared prior (Gelman et al., Bayesian
// Data Analysis, 2.6), which counts for less where the corners deny it.
double sigma_of(const std::vector<double>& noise, const Scatter& scatter) {
    double expected = 0;
    for (const double sigma : noise) expected += sigma * sigma / double(noise.size());
    const double seen = scatter.squares / std::max(scatter.freedom, 1);
    const double excess = MOST_EXCESS * expected;
    const double worth = seen <= excess ? NOISE_WORTH : NOISE_WORTH * excess / seen;
    const double variance =
        (worth * expected + scatter.squares) / std::max(worth + scatter.freedom, 1e-9);
    return std::max(LEAST_SIGMA_PX, std::sqrt(variance));
}

}  // namespace

std::optional<Measured> measured(const Grey& grey, const CornerPattern& pattern,
                                 const PlanarFit& fit, const std::vector<Eigen::Vector2d>& starts,
                                 const Blur& blur, bool is_rough) {
    std::vector<int> ids;
    std::vector<Eigen::Vector2d> near;
    for (Eigen::Index id = 0; id < pattern.points.rows(); ++id) {
        if (!is_in_view(fit, pattern.points.row(id), double(grey.width), double(grey.height)))
            continue;
        ids.push_back(static_cast<int>(id));
        if (!starts.empty()) near.push_back(starts[static_cast<std::size_t>(id)]);
    }
    if (ids.empty()) return std::nullopt;
    Registration found = registered(grey, pattern, fit, ids, near, blur, is_rough);
    if (!near.empty()) ask_gradients(grey, near, found);

    Measured made;
    made.blur = found.blur, made.fit = found.fit;
    std::vector<double> sigma;
    SoundLimits limits;
    limits.least_px = LEAST_WILD_PX, limits.enough_px = ENOUGH_PX;
    for (std::size_t i = 0; i < ids.size(); ++i) {
        if (!found.is_clear[i]) continue;
        made.corners.push_back(ids[i]);
        made.pixels.push_back(found.pixels[i]);
        sigma.push_back(found.sigma[i]);
        limits.least_share.push_back(found.is_whole[i] ? WHOLE_WILD_SHARE : LEAST_WILD_SHARE);
    }
    const std::size_t n = made.corners.size();
    if (n == 0) return std::nullopt;
    if (n < LEAST_CORNERS) {
        made.sigma = FEW_CORNERS_SIGMA_PX;
        return made;
    }
    const auto rows = static_cast<Eigen::Index>(n);
    Points points(rows, 2), pixels(rows, 2);
    for (Eigen::Index i = 0; i < rows; ++i) {
        points.row(i) = pattern.points.row(made.corners[i]);
        pixels.row(i) = made.pixels[i].transpose();
    }
    std::vector<char> keep;
    const auto plane = sound_corners(points, pixels, found.fit, true, limits, keep);
    if (!plane) return std::nullopt;
    Eigen::Index kept = 0;
    for (Eigen::Index i = 0; i < rows; ++i) {
        if (!keep[i]) continue;
        points.row(kept) = points.row(i), pixels.row(kept) = pixels.row(i);
        made.corners[kept] = made.corners[i], made.pixels[kept] = made.pixels[i];
        sigma[kept++] = sigma[i];
    }
    made.corners.resize(kept), made.pixels.resize(kept), sigma.resize(kept);
    made.fit = *plane;
    made.sigma = sigma_of(sigma, scatter_about(*plane, points.topRows(kept), pixels.topRows(kept)));
    return made;
}

Eigen::Vector2d where_gradients_meet(const Grey& grey, const Eigen::Vector2d& start) {
    constexpr int HALF = 4, STEPS = 20;
    constexpr double SHORT_PX = 0.01;
    Eigen::Vector2d corner = start;
    for (int step = 0; step < STEPS; ++step) {
        Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
        Eigen::Vector2d right = Eigen::Vector2d::Zero();
        for (int y = -HALF; y <= HALF; ++y) {
            for (int x = -HALF; x <= HALF; ++x) {
                const auto at = [&](int dx, int dy) {
                    return double(grey.at(float(corner.x() + x + dx), float(corner.y() + y + dy)));
                };
                const double share = std::exp(-double(x * x + y * y) / (HALF * HALF));
                const Eigen::Vector2d slope(0.5 * (at(1, 0) - at(-1, 0)),
                                            0.5 * (at(0, 1) - at(0, -1)));
                const Eigen::Matrix2d product = share * slope * slope.transpose();
                normal += product;
                right += product * Eigen::Vector2d(x, y);
            }
        }
        const double determinant = normal.determinant();
        if (!(std::abs(determinant) > 1e-12)) return corner;
        const Eigen::Vector2d moved = normal.inverse() * right;
        if (!moved.allFinite() || (corner + moved - start).norm() > 2 * HALF) return start;
        corner += moved;
        if (moved.norm() < SHORT_PX) break;
    }
    return corner;
}

}  // namespace trigpoint

using namespace trigpoint;

TRIGPOINT_OBJECT(tp_pattern, CornerPattern)

// (pattern, points (n, 2), outward (n, 2), reach, square): a pattern without prints.
TRIGPOINT_KERNEL(tp_pattern_set) {
    auto& pattern = *static_cast<CornerPattern*>(arguments[0].object);
    pattern.points = arguments[1].array.rows<2>();
    pattern.outward = arguments[2].array.rows<2>();
    pattern.reach = arguments[3].number, pattern.square = arguments[4].number;
    if (!(pattern.reach > 0 && pattern.square > 0))
        throw std::invalid_argument("a pattern's lengths are above 0");
    pattern.is_balanced = pattern.outward.isZero(0);
    pattern.prints.clear();
    return 0;
}

// (pattern, texels (h, w), scale, offset x, offset y): one more print, finer than the last.
TRIGPOINT_KERNEL(tp_pattern_print) {
    auto& pattern = *static_cast<CornerPattern*>(arguments[0].object);
    const Grey texels = Grey::of(arguments[1].array);
    constexpr std::int64_t MOST_TEXELS = 1 << 30;
    if (texels.height < 1 || texels.width < 1 || texels.height * texels.width > MOST_TEXELS)
        throw std::invalid_argument("a print has 1 to 2^30 texels");
    pattern.prints.emplace_back(texels, arguments[2].number,
                                Eigen::Vector2d(arguments[3].number, arguments[4].number));
    return 0;
}

// (grey (h, w), pattern, fit, starts (n, 2) or none, blur (4), is rough, last corners (k,), least
// again, corners (n,), pixels (n, 2), numbers: sigma and blur (5), fit out): how many corners there
// are; none where they are less than that share of the last ones that are in view.
TRIGPOINT_KERNEL(tp_measured) {
    const Grey grey = Grey::of(arguments[0].array);
    const auto& pattern = *static_cast<const CornerPattern*>(arguments[1].object);
    const PlanarFit fit = PlanarFit::unpacked(arguments[2].array.as<double>());
    const auto rows = arguments[3].array.rows<2>();
    const Array &last = arguments[6].array, &corners = arguments[8].array;
    if (pattern.prints.empty() || corners.shape[0] != pattern.points.rows() ||
        (rows.rows() != 0 && rows.rows() != pattern.points.rows()))
        throw std::invalid_argument("the pattern is not that of the corners");
    std::vector<Eigen::Vector2d> starts;
    for (Eigen::Index i = 0; i < rows.rows(); ++i) starts.push_back(rows.row(i));
    const auto given = arguments[4].array.rows<1>();
    const Blur blur{given.head<3>(), given(3)};
    if (grey.width < 1 || grey.height < 1 || !fit.homography.allFinite() || !given.allFinite())
        return 0;
    const auto found = measured(grey, pattern, fit, starts, blur, arguments[5].whole != 0);
    if (!found) return 0;
    const auto count = static_cast<Eigen::Index>(found->corners.size());
    double still = 0;
    for (std::int64_t i = 0; i < last.shape[0]; ++i) {
        const std::int64_t id = last.as<const std::int64_t>()[i];
        if (!(id >= 0 && id < pattern.points.rows()))
            throw std::invalid_argument("a corner is none of the pattern's");
        still +=
            is_in_view(found->fit, pattern.points.row(id), double(grey.width), double(grey.height));
    }
    if (static_cast<double>(count) < arguments[7].number * still) return 0;
    auto pixels = arguments[9].array.rows<2>();
    for (Eigen::Index i = 0; i < count; ++i) {
        corners.as<std::int64_t>()[i] = found->corners[i];
        pixels.row(i) = found->pixels[i].transpose();
    }
    auto numbers = arguments[10].array.rows<1>();
    numbers(0) = found->sigma;
    numbers.segment<3>(1) = found->blur.variances;
    numbers(4) = found->blur.response;
    found->fit.pack(arguments[11].array.as<double>());
    return count;
}

// (fit, points (n, 2), width, height): how many points of a face lie in a picture of that size.
TRIGPOINT_KERNEL(tp_in_view) {
    const PlanarFit fit = PlanarFit::unpacked(arguments[0].array.as<double>());
    const auto points = arguments[1].array.rows<2>();
    const auto width = static_cast<double>(arguments[2].whole),
               height = static_cast<double>(arguments[3].whole);
    std::int64_t count = 0;
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        count += is_in_view(fit, points.row(i), width, height);
    return count;
}
