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
constexpr int MOST_SOFT = LATTICE * (SIDE - 1) + 1 + 2 * EDGE;
constexpr int MOST_SHARP = MOST_SOFT + 2 * MOST_RADIUS;
// Its rows in memory: what is softened goes in eights, what is read of it in WIDTH pixels.
constexpr int EIGHT = 8, MOST_EIGHTS = (MOST_SOFT + EIGHT - 1) / EIGHT;
constexpr int SHARP_WIDTH = EIGHT * MOST_EIGHTS + 2 * MOST_RADIUS;
constexpr int SOFT_WIDTH = LATTICE * WIDTH + 2 * EDGE;
static_assert(SOFT_WIDTH >= EIGHT * MOST_EIGHTS && WIDTH >= SIDE);

struct Texels {
    Eigen::Matrix3d from_face;

    explicit Texels(const Print& print) {
        from_face << print.scale, 0, print.offset.x(), 0, print.scale, print.offset.y(), 0, 0, 1;
    }
};

// The values of a print at places, of 0 to 1, interpolated; beyond its edge as at the edge.
TRIGPOINT_WIDE
void sample(const Print& print, const float* __restrict x, const float* __restrict y, int count,
            float* __restrict values) {
    const auto right = static_cast<float>(print.width - 1),
               bottom = static_cast<float>(print.height - 1);
    std::array<std::int32_t, SHARP_WIDTH> cell;
    std::array<float, SHARP_WIDTH> across, down;
    for (int i = 0; i < count; ++i) {
        float u = x[i] > 0 ? x[i] : 0, v = y[i] > 0 ? y[i] : 0;
        u = u < right ? u : right, v = v < bottom ? v : bottom;
        const auto column = static_cast<std::int32_t>(u), line = static_cast<std::int32_t>(v);
        cell[i] = line * print.width + column;
        across[i] = u - static_cast<float>(column), down[i] = v - static_cast<float>(line);
    }
    std::array<std::uint32_t, SHARP_WIDTH> four;
    for (int i = 0; i < count; ++i) four[i] = print.cells[static_cast<std::size_t>(cell[i])];
    for (int i = 0; i < count; ++i) {
        const auto texel = [&](int shift) {
            return static_cast<float>(static_cast<std::int32_t>(four[i] >> shift & 255));
        };
        const float above = texel(0) + across[i] * (texel(8) - texel(0));
        const float below = texel(16) + across[i] * (texel(24) - texel(16));
        values[i] = (above + down[i] * (below - above)) * (1 / WHITE);
    }
}

// Of a lattice with `radius` more on every side, softened: `height` rows of so many eights.
template <int EIGHTS>
inline __attribute__((always_inline)) void soften_rows(const float* __restrict sharp,
                                                       const Kernel& kernel, int height,
                                                       float* __restrict soft) {
    using Eight = float __attribute__((vector_size(EIGHT * sizeof(float))));
    const int taps = 2 * kernel.radius + 1;
    for (int y = 0; y < height; ++y) {
        Eight line[EIGHTS] = {};
        const float* share = kernel.shares.data();
        for (int j = 0; j < taps; ++j) {
            for (int i = 0; i < taps; ++i, ++share) {
                for (int k = 0; k < EIGHTS; ++k) {
                    Eight from;
                    std::memcpy(&from, sharp + (y + j) * SHARP_WIDTH + i + EIGHT * k, sizeof(from));
                    line[k] += *share * from;
                }
            }
        }
        std::memcpy(soft + y * SOFT_WIDTH, line, sizeof(line));
    }
}

TRIGPOINT_WIDE
void soften(const float* sharp, const Kernel& kernel, int side, float* soft) {
    if (side <= 3 * EIGHT) {
        soften_rows<3>(sharp, kernel, side, soft);
    } else {
        soften_rows<MOST_EIGHTS>(sharp, kernel, side, soft);
    }
}

// What explains the pixels of one row of a patch: the softened drawing about it, whether each
// counts (1 or 0), and the blur's response.
TRIGPOINT_WIDE
void explain(const float* __restrict soft, const float* __restrict counts, float response,
             float* __restrict rows) {
    constexpr int PLANE = SIDE * WIDTH, DOWN = SOFT_WIDTH;
    for (int i = 0; i < WIDTH; ++i) {
        const float* at = soft + LATTICE * i;
        const float one = counts[i], value = at[0], right = at[1], before = at[-1],
                    below = at[DOWN], above = at[-DOWN], bump = value * (1 - value);
        const float slope = one * (1 + response * (1 - 2 * value));
        // To the fourth order, as blurred edges need; over one pixel alone a derivative comes out a
        // twentieth too low, and a step as much too long.
        rows[BY_X * PLANE + i] =
            slope * ((right - before) * (4.0F / 3) - (at[2] - at[-2]) * (1.0F / 6));
        rows[BY_Y * PLANE + i] =
            slope * ((below - above) * (4.0F / 3) - (at[2 * DOWN] - at[-2 * DOWN]) * (1.0F / 6));
        rows[VALUE * PLANE + i] = one * (value + response * bump);
        // What a wider blur changes is half the second derivatives (the heat equation).
        rows[XX * PLANE + i] = slope * (2 * (right + before - 2 * value));
        rows[YY * PLANE + i] = slope * (2 * (below + above - 2 * value));
        rows[XY * PLANE + i] = slope * (at[DOWN + 1] - at[DOWN - 1] - at[1 - DOWN] + at[-1 - DOWN]);
        rows[BUMP * PLANE + i] = one * bump;
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

    // The places of a row: `count` from `from` on, `step` apart; 0 where one is no number.
    void row(double dy, double from, double step, int count, float* __restrict to_x,
             float* __restrict to_y) const {
        const Eigen::Vector2d begin = at(from, dy), slope = step * (x + dy * xy + 2 * from * xx),
                              bend = step * step * xx;
        const bool is_known = begin.allFinite() && slope.allFinite() && bend.allFinite();
        const Eigen::Vector2f a = is_known ? Eigen::Vector2f(begin.cast<float>())
                                           : Eigen::Vector2f(Eigen::Vector2f::Zero()),
                              b = is_known ? Eigen::Vector2f(slope.cast<float>()) : a,
                              c = is_known ? Eigen::Vector2f(bend.cast<float>()) : a;
        for (int i = 0; i < count; ++i) {
            const auto t = static_cast<float>(i);
            to_x[i] = a.x() + t * (b.x() + t * c.x());
            to_y[i] = a.y() + t * (b.y() + t * c.y());
        }
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
      fit_(fit),
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
        longest = std::max(longest, (across.cwiseAbs() + down.cwiseAbs()).maxCoeff());
        reaches.push_back((across.norm() + down.norm()) / 2);
    }
    half_ = static_cast<int>(
        std::clamp(std::ceil(longest), double(LEAST_HALF_PX), double(MOST_HALF_PX)));
    const double reach_px = reaches.empty() ? 1 : median(reaches);
    print_ = &pattern.print_for(reach_px / pattern.reach * pattern.square);
    texel_from_pixel_ = Unprojection(fit, Texels(*print_).from_face);
}

void Drawer::draw(int id, const Eigen::Vector2d& pixel, const Eigen::Vector2d& nearest,
                  bool is_light_even, Patch& patch) const {
    const Eigen::Vector2d point = pattern_.points.row(id), out = pattern_.outward.row(id);
    const Eigen::Vector2d middle = nearest - (pixel - fit_.project(point));
    const Quadratic texels(texel_from_pixel_, middle, STENCIL * (half_ + MARGIN_PX));
    const int side = 2 * half_ + 1, soft_side = LATTICE * (side - 1) + 1 + 2 * EDGE;
    const int sharp_side = soft_side + 2 * kernel_.radius;
    const int sharp_width = EIGHT * (soft_side <= 3 * EIGHT ? 3 : MOST_EIGHTS) + 2 * kernel_.radius;

    std::array<float, MOST_SHARP * SHARP_WIDTH> sharp;
    const int first = -(LATTICE * half_ + EDGE + kernel_.radius);
    std::array<float, SHARP_WIDTH> x, y;
    for (int j = 0; j < sharp_side; ++j) {
        texels.row(double(first + j) / LATTICE, double(first) / LATTICE, 1.0 / LATTICE, sharp_width,
                   x.data(), y.data());
        sample(*print_, x.data(), y.data(), sharp_width, sharp.data() + j * SHARP_WIDTH);
    }
    std::array<float, MOST_SOFT * SOFT_WIDTH> soft{};
    soften(sharp.data(), kernel_, soft_side, soft.data());

    const Eigen::Vector2d corner = point * print_->scale + print_->offset;
    const auto corner_x = static_cast<float>(corner.x()), corner_y = static_cast<float>(corner.y());
    const auto reach = static_cast<float>(pattern_.reach * print_->scale);
    const auto out_x = static_cast<float>(out.x()), out_y = static_cast<float>(out.y());
    const bool has_unknown = !out.isZero(0);
    const auto left = static_cast<std::int64_t>(nearest.x()) - part_.left - half_,
               top = static_cast<std::int64_t>(nearest.y()) - part_.top - half_;
    const int begin = static_cast<int>(std::clamp<std::int64_t>(-left, 0, side)),
              end = static_cast<int>(std::clamp<std::int64_t>(part_.grey.width - left, 0, side));
    patch.count = side * WIDTH, patch.total = 0;
    for (int j = 0; j < side; ++j) {
        std::array<float, WIDTH> counts{};
        float* rows = patch.rows[0].data() + j * WIDTH;
        const auto row = [&](Row which) { return patch.rows[which].data() + j * WIDTH; };
        std::fill_n(row(SEEN), WIDTH, 0.0F);
        if (top + j >= 0 && top + j < part_.grey.height) {
            texels.row(j - half_, -half_, 1, side, x.data(), y.data());
            const std::uint8_t* grey = part_.grey.row(top + j);
            for (int i = begin; i < end; ++i) {
                const float off_x = x[i] - corner_x, off_y = y[i] - corner_y;
                const bool is_unknown =
                    has_unknown && off_x * out_x > -SLACK * reach && off_y * out_y > -SLACK * reach;
                counts[i] = std::abs(off_x) < reach && std::abs(off_y) < reach && !is_unknown;
                row(SEEN)[i] = counts[i] * (grey[left + i] - MIDDLE);
                patch.total += counts[i];
            }
        }
        explain(soft.data() + (LATTICE * j + EDGE) * SOFT_WIDTH + EDGE, counts.data(), response_,
                rows);
        for (int i = 0; i < WIDTH; ++i) {
            const float rises = is_light_even ? 0 : counts[i], middle_of = float(side - 1);
            row(ONE)[i] = counts[i];
            row(RISE_X)[i] = rises * (float(i) / middle_of - 0.5F);
            row(RISE_Y)[i] = rises * (float(j) / middle_of - 0.5F);
        }
    }
}

}  // namespace trigpoint
