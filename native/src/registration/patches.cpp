#include "registration/patches.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace trigpoint {
namespace {

constexpr int MARGIN_PX = 3;
// Where the map from pixels to the print is looked up: so far from a patch's middle, of its half.
constexpr double STENCIL = 0.75;
constexpr float SLACK = 0.05F;  // of the reach, left out beside an unknown sector
constexpr float WHITE = 255, MIDDLE = 128;
// The drawing's side on the lattice: what derivatives are taken from, and what blur comes from.
constexpr int EDGE = 2;
constexpr int MOST_SIDE = LATTICE * (SIDE - 1) + 1 + 2 * EDGE + 2 * MOST_RADIUS;
// Samples are drawn in eights, and rows explained in WIDTH pixels, the last ones beyond the end.
constexpr int EIGHT = 8, MOST_WIDTH = EIGHT * ((MOST_SIDE + EIGHT - 1) / EIGHT);

constexpr int BEYOND = LATTICE * WIDTH + EDGE;

// A drawing on the lattice, row after row.
using Drawing = std::array<float, MOST_SIDE * MOST_SIDE + BEYOND>;

// The places of a row on a print: from the first one on, each at the next whole number.
struct Line {
    Eigen::Vector2f begin, slope, bend;
};

// The values of a print along a line, of 0 to 1, interpolated; beyond its edge as at the edge.
TRIGPOINT_WIDE
void sample(const Print& print, const Line& line, int count, float* __restrict values) {
    const auto right = static_cast<float>(print.width - 1),
               bottom = static_cast<float>(print.height - 1);
    const float x = line.begin.x(), y = line.begin.y(), slope_x = line.slope.x(),
                slope_y = line.slope.y(), bend_x = line.bend.x(), bend_y = line.bend.y();
    std::array<std::int32_t, MOST_WIDTH> cell;
    std::array<float, MOST_WIDTH> across, down;
    for (int i = 0; i < count; ++i) {
        const auto t = static_cast<float>(i);
        float u = x + t * (slope_x + t * bend_x), v = y + t * (slope_y + t * bend_y);
        u = u > 0 ? u : 0, v = v > 0 ? v : 0;
        u = u < right ? u : right, v = v < bottom ? v : bottom;
        const auto column = static_cast<std::int32_t>(u), row = static_cast<std::int32_t>(v);
        cell[i] = row * print.width + column;
        across[i] = u - static_cast<float>(column), down[i] = v - static_cast<float>(row);
    }
    std::array<std::uint32_t, MOST_WIDTH> four;
    for (int i = 0; i < count; ++i) four[i] = print.cells[static_cast<std::size_t>(cell[i])];
    for (int i = 0; i < count; ++i) values[i] = between(four[i], across[i], down[i]) * (1 / WHITE);
}

// Of `count` values the sums of those about them, `apart` in memory, two by two with their share;
// added to what is there, or in its place.
template <int RADIUS, bool IS_EVEN, bool ADDS>
inline __attribute__((always_inline)) void filter(const float* __restrict from, int apart,
                                                  const Kernel::Taps& shares, int count,
                                                  float* __restrict to) {
    for (int n = 0; n < count; ++n) {
        float sum = ADDS ? to[n] : 0;
        if (IS_EVEN) sum += shares[RADIUS] * from[n + RADIUS * apart];
        for (int i = 0; i < RADIUS; ++i) {
            const float first = from[n + i * apart], last = from[n + (2 * RADIUS - i) * apart];
            sum += shares[i] * (IS_EVEN ? first + last : first - last);
        }
        to[n] = sum;
    }
}

// A drawing softened: `side` rows of it, as wide in memory as the sharp one, which has `radius`
// more on every side. Rows are taken as one line: what runs over at their ends is not read.
template <int RADIUS>
inline __attribute__((always_inline)) void soften_by(const Drawing& sharp, const Kernel& kernel,
                                                     int side, Drawing& soft) {
    const int width = side + 2 * RADIUS;
    Drawing across;
    // What a product with 0 is made of is a number.
    std::fill_n(across.begin() + width * width - 2 * RADIUS, 2 * RADIUS, 0.0F);
    std::fill_n(soft.begin() + side * width, BEYOND, 0.0F);
    if (kernel.terms == 0) soft.fill(0);  // of a blur that is no number
    for (int term = 0; term < kernel.terms; ++term) {
        const auto& row = kernel.across[term];
        const auto& column = kernel.down[term];
        const int all = width * width - 2 * RADIUS, down = side * width;
        if (term < kernel.even) {
            filter<RADIUS, true, false>(sharp.data(), 1, row, all, across.data());
        } else {
            filter<RADIUS, false, false>(sharp.data(), 1, row, all, across.data());
        }
        if (term == 0) {
            filter<RADIUS, true, false>(across.data(), width, column, down, soft.data());
        } else if (term < kernel.even) {
            filter<RADIUS, true, true>(across.data(), width, column, down, soft.data());
        } else {
            filter<RADIUS, false, true>(across.data(), width, column, down, soft.data());
        }
    }
}

TRIGPOINT_WIDE
void soften(const Drawing& sharp, const Kernel& kernel, int side, Drawing& soft) {
    static_assert(LEAST_RADIUS == 2 && MOST_RADIUS == 6);
    switch (kernel.radius) {
        case 2:
            return soften_by<2>(sharp, kernel, side, soft);
        case 3:
            return soften_by<3>(sharp, kernel, side, soft);
        case 4:
            return soften_by<4>(sharp, kernel, side, soft);
        case 5:
            return soften_by<5>(sharp, kernel, side, soft);
        default:
            return soften_by<6>(sharp, kernel, side, soft);
    }
}

// What counts about a corner, at `corner` of the print: what is nearer than `reach` along both
// axes, but for an unknown sector, whose axes have the signs `outward`.
struct Surroundings {
    Eigen::Vector2f corner, outward;
    float reach;
};

// What is seen of a row of a patch, whose places are a line, and whether each pixel counts (1 or
// 0); the picture has those from `begin` to `end`. How many do.
TRIGPOINT_WIDE
int see(const Line& line, const Surroundings& about, const std::uint8_t* grey, int begin, int end,
        float* __restrict counts, float* __restrict seen) {
    std::array<std::uint8_t, WIDTH> bytes{};
    std::memcpy(bytes.data() + begin, grey + begin, static_cast<std::size_t>(end - begin));
    const float x = line.begin.x() - about.corner.x(), y = line.begin.y() - about.corner.y(),
                slope_x = line.slope.x(), slope_y = line.slope.y(), bend_x = line.bend.x(),
                bend_y = line.bend.y(), reach = about.reach, out_x = about.outward.x(),
                out_y = about.outward.y();
    const int has_unknown = out_x != 0 || out_y != 0;
    int total = 0;
    for (int i = 0; i < WIDTH; ++i) {
        const auto t = static_cast<float>(i);
        const float off_x = x + t * (slope_x + t * bend_x), off_y = y + t * (slope_y + t * bend_y);
        const int is_unknown =
            has_unknown & (off_x * out_x > -SLACK * reach) & (off_y * out_y > -SLACK * reach);
        const int is_known = (i >= begin) & (i < end) & (std::abs(off_x) < reach) &
                             (std::abs(off_y) < reach) & !is_unknown;
        total += is_known;
        counts[i] = static_cast<float>(is_known);
        seen[i] = counts[i] * (static_cast<float>(bytes[i]) - MIDDLE);
    }
    return total;
}

// What explains the pixels of a patch, by the softened drawing, `width` in memory, whether each
// counts, which is its row ONE, the blur's response, and how much the light may rise from pixel to
// pixel.
TRIGPOINT_WIDE
void explain(const Drawing& soft, int width, int side, float response, float rise, Patch& patch) {
    // Every other value, so that pixels lie side by side.
    constexpr int ROW = WIDTH + EDGE;
    std::array<float, (LATTICE * SIDE + 2 * EDGE) * ROW> on_pixels, between;
    for (int y = 0; y < LATTICE * (side - 1) + 1 + 2 * EDGE; ++y) {
        const float* __restrict from = soft.data() + y * width;
        float* __restrict even = on_pixels.data() + y * ROW, * __restrict odd =
                                                                 between.data() + y * ROW;
        for (int i = 0; i < ROW; ++i) even[i] = from[LATTICE * i], odd[i] = from[LATTICE * i + 1];
    }
    const float middle = rise > 0 ? 0.5F : 0;
    for (int j = 0; j < side; ++j) {
        constexpr int PLANE = SIDE * WIDTH;
        const float rise_y = rise * static_cast<float>(j) - middle;
        const float* __restrict even = on_pixels.data() + (LATTICE * j + EDGE) * ROW;
        const float* __restrict odd = between.data() + (LATTICE * j + EDGE) * ROW;
        float* __restrict rows = patch.rows[0].data() + j * WIDTH;
        for (int i = 0; i < WIDTH; ++i) {
            const float one = rows[ONE * PLANE + i], value = even[i + 1], right = odd[i + 1],
                        before = odd[i], below = even[i + 1 + ROW], above = even[i + 1 - ROW],
                        bump = value * (1 - value);
            const float slope = one * (1 + response * (1 - 2 * value));
            // To the fourth order, as blurred edges need; over one pixel alone a derivative comes
            // out a twentieth too low, and a step as much too long.
            rows[BY_X * PLANE + i] =
                slope * ((right - before) * (4.0F / 3) - (even[i + 2] - even[i]) * (1.0F / 6));
            rows[BY_Y * PLANE + i] =
                slope * ((below - above) * (4.0F / 3) -
                         (even[i + 1 + 2 * ROW] - even[i + 1 - 2 * ROW]) * (1.0F / 6));
            rows[VALUE * PLANE + i] = one * (value + response * bump);
            // What a wider blur changes is half the second derivatives (the heat equation).
            rows[XX * PLANE + i] = slope * (2 * (right + before - 2 * value));
            rows[YY * PLANE + i] = slope * (2 * (below + above - 2 * value));
            rows[XY * PLANE + i] =
                slope * (odd[i + 1 + ROW] - odd[i + 1 - ROW] - odd[i + ROW] + odd[i - ROW]);
            rows[BUMP * PLANE + i] = one * bump;
            rows[RISE_X * PLANE + i] = one * (rise * static_cast<float>(i) - middle);
            rows[RISE_Y * PLANE + i] = one * rise_y;
        }
    }
}

}  // namespace

Print::Print(const Grey& texels, double a_scale, const Eigen::Vector2d& an_offset)
    : height(static_cast<int>(texels.height)),
      width(static_cast<int>(texels.width)),
      scale(a_scale),
      offset(an_offset) {
    cells.reserve(static_cast<std::size_t>(texels.height * texels.width));
    for (int y = 0; y < height; ++y) {
        const std::uint8_t *here = texels.row(y), *below = texels.row(std::min(y + 1, height - 1));
        for (int x = 0; x < width; ++x) {
            const int next = std::min(x + 1, width - 1);
            cells.push_back(std::uint32_t{here[x]} | std::uint32_t{here[next]} << 8 |
                            std::uint32_t{below[x]} << 16 | std::uint32_t{below[next]} << 24);
        }
    }
}

Eigen::Matrix3d Print::from_face() const {
    return Eigen::Matrix3d{{scale, 0, offset.x()}, {0, scale, offset.y()}, {0, 0, 1}};
}

// So near a corner a map is quadratic in the pixels, to a thousandth: the one of least squares
// through nine places, at `STENCIL` of a patch's half to all sides.
struct Drawer::Quadratic {
    Eigen::Vector2d constant, x, y, xx, yy, xy;

    Quadratic(const Unprojection& map, const Eigen::Vector2d& middle, double reach) {
        constant.setZero(), x.setZero(), y.setZero(), xx.setZero(), yy.setZero(), xy.setZero();
        for (int v = -1; v <= 1; ++v) {
            for (int u = -1; u <= 1; ++u) {
                const Eigen::Vector2d there = map(middle + reach * Eigen::Vector2d(u, v));
                constant += there / 9, x += u * there / 6, y += v * there / 6;
                xx += (u * u - 2.0 / 3) * there / 2, yy += (v * v - 2.0 / 3) * there / 2;
                xy += u * v * there / 4;
            }
        }
        constant -= (xx + yy) * 2 / 3;
        x /= reach, y /= reach, xx /= reach * reach, yy /= reach * reach, xy /= reach * reach;
    }

    Eigen::Vector2d at(double dx, double dy) const {
        return constant + dx * (x + dx * xx + dy * xy) + dy * (y + dy * yy);
    }

    // The places of a row, `step` apart; 0 where one is no number.
    Line line(double dy, double from, double step) const {
        const Eigen::Vector2d begin = at(from, dy), slope = step * (x + dy * xy + 2 * from * xx),
                              bend = step * step * xx;
        if (!(begin + slope + bend).allFinite()) return {{0, 0}, {0, 0}, {0, 0}};
        return {begin.cast<float>(), slope.cast<float>(), bend.cast<float>()};
    }
};

const Print& CornerPattern::print_for(double square_px) const {
    for (const Print& print : prints)
        if (print.scale * square >= 0.8 * square_px) return print;
    return prints.back();
}

Drawer::Drawer(const PartOfPicture& part, const CornerPattern& pattern, const PlanarFit& fit,
               const std::vector<int>& ids, const Blur& blur)
    : part_(part),
      pattern_(pattern),
      ids_(ids),
      print_(nullptr),
      texel_from_pixel_(fit),
      kernel_(blur.kernel(LATTICE)),
      response_(static_cast<float>(blur.response)) {
    double longest = 0;
    std::vector<double> reaches;
    for (const int id : ids) {
        const Eigen::Vector2d point = pattern.points.row(id), here = fit.project(point);
        const Eigen::Vector2d across =
            fit.project(point + Eigen::Vector2d(pattern.reach, 0)) - here;
        const Eigen::Vector2d down = fit.project(point + Eigen::Vector2d(0, pattern.reach)) - here;
        places_.push_back(here);
        longest = std::max(longest, (across.cwiseAbs() + down.cwiseAbs()).maxCoeff());
        reaches.push_back((across.norm() + down.norm()) / 2);
    }
    half_ = static_cast<int>(
        std::clamp(std::ceil(longest), double(LEAST_HALF_PX), double(MOST_HALF_PX)));
    const double reach_px = reaches.empty() ? 1 : median(reaches);
    print_ = &pattern.print_for(reach_px / pattern.reach * pattern.square);
    texel_from_pixel_ = Unprojection(fit, print_->from_face());
}

void Drawer::draw(std::size_t i, const Eigen::Vector2d& pixel, const Eigen::Vector2d& nearest,
                  bool is_light_even, Patch& patch) const {
    const Eigen::Vector2d point = pattern_.points.row(ids_[i]), out = pattern_.outward.row(ids_[i]);
    const Eigen::Vector2d middle = nearest - (pixel - places_[i]);
    const Quadratic texels(texel_from_pixel_, middle, STENCIL * (half_ + MARGIN_PX));
    const int side = 2 * half_ + 1, soft_side = LATTICE * (side - 1) + 1 + 2 * EDGE;
    const int width = soft_side + 2 * kernel_.radius;

    Drawing sharp, soft;
    const double first = -(LATTICE * half_ + EDGE + kernel_.radius), step = 1.0 / LATTICE;
    for (int j = 0; j < width; ++j)
        sample(*print_, texels.line(step * (first + j), step * first, step),
               EIGHT * ((width + EIGHT - 1) / EIGHT), sharp.data() + j * width);
    soften(sharp, kernel_, soft_side, soft);

    const Eigen::Vector2d corner = point * print_->scale + print_->offset;
    const Surroundings about{corner.cast<float>(), out.cast<float>(),
                             static_cast<float>(pattern_.reach * print_->scale)};
    const auto left = static_cast<std::int64_t>(nearest.x()) - part_.left - half_,
               top = static_cast<std::int64_t>(nearest.y()) - part_.top - half_;
    const int begin = static_cast<int>(std::clamp<std::int64_t>(-left, 0, side)),
              end = static_cast<int>(std::clamp<std::int64_t>(part_.grey.width - left, 0, side));
    patch.count = side * WIDTH;
    int total = 0;
    for (int j = 0; j < side; ++j) {
        float *counts = patch.rows[ONE].data() + j * WIDTH,
              *seen = patch.rows[SEEN].data() + j * WIDTH;
        if (top + j >= 0 && top + j < part_.grey.height && begin < end) {
            total += see(texels.line(j - half_, -half_, 1), about, part_.grey.row(top + j) + left,
                         begin, end, counts, seen);
        } else {
            std::fill_n(counts, WIDTH, 0.0F), std::fill_n(seen, WIDTH, 0.0F);
        }
    }
    patch.total = total;
    explain(soft, width, side, response_,
            is_light_even ? 0.0F : 1.0F / static_cast<float>(side - 1), patch);
}

}  // namespace trigpoint
