#include "registration/alignment.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace trigpoint {
namespace {

// A pixel this far off the drawing, of the face's contrast, shows something else.
constexpr float FOREIGN_SHARE = 0.25F;
// Of a corner's pixels, how many must show the pattern, and how many there must be;
constexpr double LEAST_SHOWN = 0.8;
constexpr double LEAST_PIXELS = (2 * LEAST_HALF_PX + 1) * (2 * LEAST_HALF_PX + 1) / 4.0;
// its contrast, grey levels, and against the face's;
constexpr double LEAST_CONTRAST = 8.0, LEAST_CONTRAST_SHARE = 0.25;
// and how much worse than the face's it may match, beyond a little noise, grey levels².
constexpr double MOST_MISMATCH = 3.0, QUIET_POWER = 4.0;
// A seam in the print or a scratch may leave this share of the drawing's variance all the same.
constexpr double SCRATCHED_SHARE = 0.07;
// What is left may have this share of the drawing's variance, and this noise, grey levels².
constexpr double MOST_UNEXPLAINED = 0.3, NOISE_POWER = 40.0;
constexpr double WHITE = 255, TINY = 1e-6;

// Products of a row of a patch with itself and those before. Eight sums for each, so that every
// machine adds in the same order.
template <int I>
inline __attribute__((always_inline)) void add_row(const Patch& patch, float (&products)[ROWS]) {
    using Eight = float __attribute__((vector_size(32)));
    Eight sums[I + 1] = {};
    for (int p = 0; p < patch.count; p += 8) {
        Eight first, second;
        std::memcpy(&first, patch.rows[I].data() + p, sizeof(first));
        for (int j = 0; j <= I; ++j) {
            std::memcpy(&second, patch.rows[j].data() + p, sizeof(second));
            sums[j] += first * second;
        }
    }
    for (int j = 0; j <= I; ++j) {
        const Eight& s = sums[j];
        products[j] = ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
    }
}

// Products of all rows of a patch with each other, the lower half.
TRIGPOINT_WIDE
void add_products(const Patch& patch, float (&products)[ROWS][ROWS]) {
    static_assert(ROWS == 11);
    add_row<0>(patch, products[0]), add_row<1>(patch, products[1]), add_row<2>(patch, products[2]),
        add_row<3>(patch, products[3]), add_row<4>(patch, products[4]),
        add_row<5>(patch, products[5]), add_row<6>(patch, products[6]),
        add_row<7>(patch, products[7]), add_row<8>(patch, products[8]),
        add_row<9>(patch, products[9]), add_row<10>(patch, products[10]);
}

Usual usual_of(const std::vector<Match>& matches) {
    std::vector<double> gains, levels, powers;
    for (const Match& match : matches) {
        gains.push_back(match.gain());
        levels.push_back(match.values(ONE));
        powers.push_back(match.power());
    }
    return {median(gains), median(levels), median(powers)};
}

// What may be left of a corner of some contrast: where more light falls there is more of all.
double most_power(const Usual& usual, double gain) {
    const double lit = std::max(gain / std::max(usual.gain, LEAST_CONTRAST), 1.0);
    return MOST_MISMATCH * MOST_MISMATCH * (usual.power * lit * lit + QUIET_POWER);
}

// Whether something else may cover a corner in part.
bool is_odd(const Usual& usual, const Match& match) {
    return match.power() > most_power(usual, match.gain()) ||
           match.gain() < LEAST_CONTRAST_SHARE * usual.gain;
}

// Leaves out the pixels that show something else, in the light of most corners or in the corner's
// own: in the one that explains more.
void leave_foreign_out(const Usual& usual, const Match& match, Patch& patch) {
    using Light = std::array<float, 4>;  // contrast, brightness, and the rise of that
    const Light common = {float(usual.gain), float(usual.level), 0, 0};
    const bool is_faint = match.gain() < LEAST_CONTRAST_SHARE * usual.gain;
    Light own;
    for (int k = 0; k < 4; ++k) own[k] = float(match.values(VALUE + k));
    const auto is_foreign = [&](int p, const Light& light) {
        float drawn = 0;
        for (int k = 0; k < 4; ++k) drawn += light[k] * patch.rows[VALUE + k][p];
        return std::abs(patch.rows[SEEN][p] - drawn) > FOREIGN_SHARE * std::abs(light[0]);
    };
    const auto foreign_in = [&](const Light& light) {
        int count = 0;
        for (int p = 0; p < patch.count; ++p) count += is_foreign(p, light);
        return count;
    };
    const Light& best = is_faint || foreign_in(common) <= foreign_in(own) ? common : own;
    for (int p = 0; p < patch.count; ++p)
        if (is_foreign(p, best))
            for (auto& row : patch.rows) row[p] = 0;
}

// Whether the picture shows a corner as it is printed.
bool is_clear(const Usual& usual, const Match& match) {
    const double drawn = match.gain() * match.gain() * match.variance;
    return match.count > std::max(LEAST_SHOWN * match.total, LEAST_PIXELS) &&
           match.gain() > std::max(LEAST_CONTRAST_SHARE * usual.gain, LEAST_CONTRAST) &&
           match.power() < std::max(most_power(usual, match.gain()), SCRATCHED_SHARE * drawn) &&
           match.power() < NOISE_POWER + MOST_UNEXPLAINED * drawn;
}

}  // namespace

Match Match::of(const Patch& patch) {
    float sums[ROWS][ROWS];
    add_products(patch, sums);
    Eigen::Matrix<double, ROWS, ROWS> products;
    for (int i = 0; i < ROWS; ++i)
        for (int j = 0; j <= i; ++j) products(i, j) = products(j, i) = sums[i][j];
    Match match;
    match.total = patch.total;
    match.count = products(ONE, ONE);
    const double some = std::max(match.count, 1.0), mean = products(VALUE, ONE) / some;
    match.variance = products(VALUE, VALUE) / some - mean * mean;
    Eigen::Matrix<double, OWN, OWN> own = products.topLeftCorner<OWN, OWN>();
    own.diagonal().array() += TINY;
    const Eigen::LLT<Eigen::Matrix<double, OWN, OWN>> solver(own);
    for (int i = 0; i < OWN; ++i)  // column by column all is unrolled
        match.inverse.col(i) = solver.solve(Eigen::Matrix<double, OWN, 1>::Unit(i));
    const auto right = products.topRightCorner<OWN, SHARED + 1>();
    const Eigen::Matrix<double, OWN, SHARED + 1> solved = match.inverse * right;
    match.left = products.bottomRightCorner<SHARED + 1, SHARED + 1>() - right.transpose() * solved;
    match.by_blur = solved.leftCols<SHARED>();
    match.values = solved.col(SHARED);
    return match;
}

double Alignment::usual_length() const {
    std::vector<double> lengths;
    for (const Corner& corner : corners)
        if (corner.is_clear) lengths.push_back(corner.step.norm());
    return lengths.empty() ? std::numeric_limits<double>::infinity() : median(lengths);
}

bool Alignment::has_clear() const {
    return std::any_of(corners.begin(), corners.end(), [](const Corner& c) { return c.is_clear; });
}

Alignment aligned(const PartOfPicture& part, const CornerPattern& pattern, const PlanarFit& fit,
                  const Corners& corners, const Blur& blur, double longest_px,
                  const std::optional<Usual>& usual, bool is_light_even) {
    const std::size_t n = corners.ids.size();
    const Drawer drawer(part, pattern, fit, corners.ids, blur);
    std::vector<Match> matches(n);
    std::vector<Patch> patch(1);  // 8 kB
    const auto draw = [&](std::size_t i) {
        drawer.draw(i, corners.pixels[i], corners.nearest[i], is_light_even, patch[0]);
    };
    for (std::size_t i = 0; i < n; ++i) {
        draw(i);
        matches[i] = Match::of(patch[0]);
    }
    Alignment found;
    found.corners.resize(n);
    found.usual = usual ? *usual : usual_of(matches);
    bool has_odd = false;
    for (std::size_t i = 0; i < n; ++i) {
        const bool odd = is_odd(found.usual, matches[i]);
        found.corners[i].is_whole = !odd;
        if (!odd) continue;
        has_odd = true;
        draw(i);
        leave_foreign_out(found.usual, matches[i], patch[0]);
        matches[i] = Match::of(patch[0]);
    }
    if (has_odd && !usual) found.usual = usual_of(matches);

    // The change of blur that all clear corners together ask for.
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    for (std::size_t i = 0; i < n; ++i) {
        const Match& match = matches[i];
        found.corners[i].is_clear = is_clear(found.usual, match);
        if (!found.corners[i].is_clear) continue;
        normal += match.gain() * match.gain() * match.left.topLeftCorner<SHARED, SHARED>();
        right += match.gain() * match.left.topRightCorner<SHARED, 1>();
    }
    normal.diagonal() *= 1 + 1e-3;
    normal.diagonal().array() += 1e-9;
    const int asked = pattern.is_balanced ? 4 : 3;
    found.change.setZero();
    const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 4, 4> part_of =
        normal.topLeftCorner(asked, asked);
    found.change.head(asked) = part_of.ldlt().solve(right.head(asked));
    if (!found.change.allFinite()) found.change.setZero();
    for (std::size_t i = 0; i < n; ++i) {
        const Match& match = matches[i];
        const Eigen::Matrix<double, OWN, 1> adapted =
            match.values - match.gain() * (match.by_blur * found.change);
        Eigen::Vector2d step = -adapted.head<2>() / std::max(adapted(VALUE), TINY * WHITE);
        step *= std::min(1.0, longest_px / std::max(step.norm(), 1e-9));
        const double spread = std::max(0.5 * (match.inverse(0, 0) + match.inverse(1, 1)), 0.0);
        auto& corner = found.corners[i];
        corner.step = step;
        corner.is_clear = corner.is_clear && step.allFinite();
        corner.sigma = std::sqrt(match.power() * spread) / std::max(match.gain(), TINY * WHITE);
    }
    found.blur =
        blur.changed(found.change, pattern.is_balanced ? LEAST_VARIANCE : LEAST_SOFT_VARIANCE);
    return found;
}

}  // namespace trigpoint
