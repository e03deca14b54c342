#include "registration/patches.hpp"

#include <algorithm>
#include <cmath>

namespace trigpoint {
namespace {

constexpr int MARGIN_PX = 3;
// Where the map from pixels to the print is looked up: so far from a patch's middle, of its half.
constexpr double STENCIL = 0.75;
constexpr double SLACK = 0.05;  // of the reach, left out beside an unknown sector
constexpr float WHITE = 255, MIDDLE = 128;
// The drawing's side on the lattice: what derivatives are taken from, and what blur comes from.
constexpr int EDGE = 2;
constexpr int MOST_SOFT = LATTICE * (SIDE - 1) + 1 + 2 * EDGE;
constexpr int MOST_SHARP = MOST_SOFT + 2 * MOST_RADIUS;

struct Texels {
    Eigen::Matrix3d from_face;

    explicit Texels(const Print& print) {
        from_face << print.scale, 0, print.offset.x(), 0, print.scale, print.offset.y(), 0, 0, 1;
    }
};

// Of a lattice `side` wide with `radius` more on every side, softened.
TRIGPOINT_WIDE
void soften(const float* __restrict sharp, const float* __restrict shares, int radius, int side,
            float* __restrict soft) {
    const int wide = side + 2 * radius, taps = 2 * radius + 1;
    for (int y = 0; y < side; ++y) {
        float line[MOST_SOFT + 3] = {};
        for (int j = 0; j < taps; ++j) {
            for (int i = 0; i < taps; ++i) {
                const float share = shares[j * taps + i];
                const float* __restrict from = sharp + (y + j) * wide + i;
                for (int x = 0; x < side; ++x) line[x] += share * from[x];
            }
        }
        for (int x = 0; x < side; ++x) soft[y * side + x] = line[x];
    }
}

}  // namespace

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

    std::array<float, MOST_SHARP * MOST_SHARP> sharp;
    const Grey print = print_->grey();
    const int first = -(LATTICE * half_ + EDGE + kernel_.radius);
    std::array<float, MOST_SHARP> texel_x, texel_y;
    for (int j = 0; j < sharp_side; ++j) {
        texels.row(double(first + j) / LATTICE, double(first) / LATTICE, 1.0 / LATTICE, sharp_side,
                   texel_x.data(), texel_y.data());
        float* to = sharp.data() + j * sharp_side;
        for (int i = 0; i < sharp_side; ++i) to[i] = print.at(texel_x[i], texel_y[i]) * (1 / WHITE);
    }
    std::array<float, MOST_SOFT * MOST_SOFT> soft;
    soften(sharp.data(), kernel_.shares.data(), kernel_.radius, soft_side, soft.data());

    const Eigen::Vector2d corner = point * print_->scale + print_->offset;
    const double reach = pattern_.reach * print_->scale;
    const auto left = static_cast<std::int64_t>(nearest.x()) - part_.left - half_,
               top = static_cast<std::int64_t>(nearest.y()) - part_.top - half_;
    patch.count = side * side, patch.total = 0;
    for (int j = 0; j < side; ++j) {
        for (int i = 0; i < side; ++i) {
            auto& row = patch.rows[j * side + i];
            row.fill(0);
            const Eigen::Vector2d off = texels.at(i - half_, j - half_) - corner;
            const bool is_inside = left + i >= 0 && left + i < part_.grey.width && top + j >= 0 &&
                                   top + j < part_.grey.height;
            const bool is_unknown = !out.isZero(0) && off.x() * out.x() > -SLACK * reach &&
                                    off.y() * out.y() > -SLACK * reach;
            if (!is_inside || is_unknown || !(off.cwiseAbs().maxCoeff() < reach)) continue;
            patch.total += 1;
            const float* at = soft.data() + (LATTICE * j + EDGE) * soft_side + LATTICE * i + EDGE;
            const int down = soft_side;
            const float value = at[0], right = at[1], before = at[-1], below = at[down],
                        above = at[-down];
            // To the fourth order, as blurred edges need; over one pixel alone a derivative comes
            // out a twentieth too low, and a step as much too long.
            row[BY_X] = (right - before) * (4.0F / 3) - (at[2] - at[-2]) * (1.0F / 6);
            row[BY_Y] = (below - above) * (4.0F / 3) - (at[2 * down] - at[-2 * down]) * (1.0F / 6);
            // What a wider blur changes is half the second derivatives (the heat equation).
            row[XX] = 2 * (right + before - 2 * value);
            row[YY] = 2 * (below + above - 2 * value);
            row[XY] = at[down + 1] - at[down - 1] - at[1 - down] + at[-1 - down];
            row[BUMP] = value * (1 - value);
            const float slope = 1 + response_ * (1 - 2 * value);
            for (const int k : {BY_X, BY_Y, XX, YY, XY}) row[k] *= slope;
            row[VALUE] = value + response_ * row[BUMP];
            row[ONE] = 1;
            if (!is_light_even) {
                row[RISE_X] = float(i) / float(side - 1) - 0.5F;
                row[RISE_Y] = float(j) / float(side - 1) - 0.5F;
            }
            row[SEEN] = part_.grey.row(top + j)[left + i] - MIDDLE;
        }
    }
}

}  // namespace trigpoint
