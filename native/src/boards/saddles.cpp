#include "boards/saddles.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace trigpoint {
namespace {

// A Gaussian of one pixel, from its middle on: a ring of 2.5 px still fits squares of 5.
constexpr std::array<float, 4> GAUSS = {0.39905028F, 0.24203623F, 0.05400558F, 0.00443305F};
constexpr int REACH = 3;
constexpr int SAMPLES = 16, HALF = SAMPLES / 2;
constexpr float RING_PX = 2.5F;
constexpr int MARGIN = 3;  // what the ring needs
// A corner of contrast C smoothed by s has sqrt(-det H) = C / (π s²); 2 is a contrast of about 15
// grey levels in a sharp picture, five times the noise of a bad camera.
constexpr float LEAST_STRENGTH = 2.0F;
constexpr float LEAST_AMPLITUDE = 5.0F;
// Of a ring's power: an X has nearly all in its even harmonics, most of that in the second.
constexpr float MOST_ODD = 0.25F, LEAST_SECOND = 0.35F;
// Curvature across a thin line against that along it; a square seen at 80 degrees has 0.03.
constexpr float LEAST_RATIO = 0.02F;
constexpr float LONGEST_STEP_PX = 1.5F;
constexpr float PI = 3.14159265358979F;
constexpr float SAMPLE_ANGLE = 2 * PI / SAMPLES;

struct Ring {
    std::array<float, SAMPLES> x, y;
};

const Ring& ring() {
    static const Ring RING = [] {
        Ring made{};
        for (int k = 0; k < SAMPLES; ++k) {
            made.x[k] = RING_PX * std::cos(k * SAMPLE_ANGLE);
            made.y[k] = RING_PX * std::sin(k * SAMPLE_ANGLE);
        }
        return made;
    }();
    return RING;
}

// The values of a picture on a ring about a place, interpolated; beyond the edge as at the edge. As
// `Picture::at`, sixteen at once.
TRIGPOINT_WIDE
void sample_ring(const Picture<float>& picture, Place at, const Ring& around, float* seen) {
    std::array<float, SAMPLES> x, y;
    for (int k = 0; k < SAMPLES; ++k) x[k] = at.x + around.x[k], y[k] = at.y + around.y[k];
    sample_at_once<SAMPLES>(picture, x.data(), y.data(), SAMPLES, seen);
}

// The same mirrored at the edge, which stands once; for lengths above REACH.
std::int64_t mirrored(std::int64_t at, std::int64_t length) {
    at = at < 0 ? -at : at;
    return at >= length ? 2 * (length - 1) - at : at;
}

TRIGPOINT_WIDE
void widen(const std::uint8_t* __restrict from, float* __restrict to, std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x) to[x] = from[x];
}

TRIGPOINT_WIDE
void halve(const float* __restrict from, float* __restrict to, std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x) to[x] = from[2 * x];
}

// Smooth along a row; `from` has REACH more on both sides of its `count`.
TRIGPOINT_WIDE
void blur_across(const float* __restrict from, float* __restrict to, std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x) {
        to[x] = GAUSS[0] * from[x + 3] + GAUSS[1] * (from[x + 2] + from[x + 4]) +
                GAUSS[2] * (from[x + 1] + from[x + 5]) + GAUSS[3] * (from[x] + from[x + 6]);
    }
}

using Rows = std::array<const float*, 2 * REACH + 1>;

TRIGPOINT_WIDE
void blur_down(const Rows& rows, float* __restrict to, std::int64_t count) {
    const float* __restrict a = rows[0], * __restrict b = rows[1], * __restrict c = rows[2], * __restrict d = rows[3], * __restrict e = rows[4], * __restrict f = rows[5], * __restrict g = rows[6];
    for (std::int64_t x = 0; x < count; ++x) {
        to[x] = GAUSS[0] * d[x] + GAUSS[1] * (c[x] + e[x]) + GAUSS[2] * (b[x] + f[x]) +
                GAUSS[3] * (a[x] + g[x]);
    }
}

// The determinant of the Hessian, negative, of the row `here` but for its ends.
TRIGPOINT_WIDE
void saddle_strength(const float* __restrict above, const float* __restrict here,
                     const float* __restrict below, float* __restrict to, std::int64_t count) {
    for (std::int64_t x = 1; x < count - 1; ++x) {
        const float xx = here[x - 1] + here[x + 1] - 2 * here[x];
        const float yy = above[x] + below[x] - 2 * here[x];
        const float xy = 0.25F * (below[x + 1] - below[x - 1] - above[x + 1] + above[x - 1]);
        to[x] = xy * xy - xx * yy;
    }
    to[0] = to[count - 1] = 0;
}

// Whether each value is above `least` and no smaller than those right beside, above and below it.
TRIGPOINT_WIDE
void might_peak(const float* __restrict above, const float* __restrict here,
                const float* __restrict below, float least, std::uint8_t* __restrict to,
                std::int64_t count) {
    for (std::int64_t x = 1; x < count - 1; ++x) {
        const float value = here[x];
        const float beside = here[x - 1] > here[x + 1] ? here[x - 1] : here[x + 1],
                    across = above[x] > below[x] ? above[x] : below[x],
                    most = beside > across ? beside : across;
        to[x] = static_cast<std::uint8_t>((value > least) & (value >= most));
    }
}

// Where a ring that is even about its middle, half of it, crosses 0 upwards or downwards: an angle
// below π; -1 where it does not do so just once.
float crossing(const std::array<float, HALF>& above, bool upwards) {
    float found = -1;
    for (int k = 0; k < HALF; ++k) {
        const float before = above[k], after = above[(k + 1) % HALF];
        if (upwards ? before <= 0 && after > 0 : before > 0 && after <= 0) {
            if (found >= 0) return -1;
            const float change = before - after;
            const float part = std::abs(change) > 1e-9F ? before / change : 0.0F;
            found = (k + std::clamp(part, 0.0F, 1.0F)) * SAMPLE_ANGLE;
        }
    }
    return found;
}

}  // namespace

void Curvature::take(const Grey& grey) {
    if (!begin(grey.width, grey.height)) return;
    smooth([&](std::int64_t y, float* row) { widen(grey.row(y), row, width_); });
    keep_saddles();
}

void Curvature::take_half(const Curvature& finer) {
    if (!begin((finer.width_ + 1) / 2, (finer.height_ + 1) / 2)) return;
    smooth([&](std::int64_t y, float* row) {
        halve(finer.smooth_.data() + 2 * y * finer.width_, row, width_);
    });
    keep_saddles();
}

bool Curvature::begin(std::int64_t width, std::int64_t height) {
    width_ = width, height_ = height;
    candidates_.clear();
    saddles_.clear();
    if (width_ > 2 * MARGIN && height_ > 2 * MARGIN) return true;
    width_ = height_ = 0;
    return false;
}

void Curvature::keep_saddles() {
    if (candidates_.size() > MOST_CANDIDATES) {
        std::nth_element(candidates_.begin(), candidates_.begin() + MOST_CANDIDATES,
                         candidates_.end(),
                         [](const auto& a, const auto& b) { return a.strength > b.strength; });
        candidates_.resize(MOST_CANDIDATES);
    }
    for (const Candidate& candidate : candidates_) {
        Saddle saddle;
        if (examine(candidate.pixel, 1.0F, saddle)) saddles_.push_back(saddle);
    }
    std::stable_sort(saddles_.begin(), saddles_.end(),
                     [](const auto& a, const auto& b) { return a.amplitude > b.amplitude; });
    saddles_.resize(std::min(saddles_.size(), MOST_SADDLES));
}

template <class Put>
void Curvature::smooth(const Put& put) {
    constexpr std::int64_t KEPT = 2 * REACH + 2;
    padded_.resize(width_ + 2 * REACH);
    across_.resize(KEPT * width_);
    smooth_.resize(width_ * height_);
    strength_.resize(5 * width_);
    might_peak_.resize(width_);
    const auto kept = [&](std::int64_t y) { return across_.data() + (y % KEPT) * width_; };
    for (std::int64_t y = 0; y < height_ + REACH + 3; ++y) {
        if (y < height_) {
            float* row = padded_.data() + REACH;
            put(y, row);
            for (std::int64_t x = 1; x <= REACH; ++x) {
                row[-x] = row[x];
                row[width_ - 1 + x] = row[width_ - 1 - x];
            }
            blur_across(padded_.data(), kept(y), width_);
        }
        const std::int64_t smoothed = y - REACH, bent = smoothed - 1, looked = bent - 2;
        if (smoothed >= 0 && smoothed < height_) {
            Rows rows;
            for (int k = 0; k <= 2 * REACH; ++k)
                rows[k] = kept(mirrored(smoothed + k - REACH, height_));
            blur_down(rows, smooth_.data() + smoothed * width_, width_);
        }
        if (bent >= 1 && bent < height_ - 1) {
            const float* here = smooth_.data() + bent * width_;
            saddle_strength(here - width_, here, here + width_, strength(bent), width_);
        }
        if (looked >= MARGIN && looked < height_ - MARGIN) peaks(looked);
    }
}

void Curvature::peaks(std::int64_t y) {
    const float* here = strength(y);
    might_peak(strength(y - 1), here, strength(y + 1), LEAST_STRENGTH * LEAST_STRENGTH,
               might_peak_.data(), width_);
    const std::array<const float*, 5> rows = {strength(y - 1), strength(y + 1), strength(y - 2),
                                              strength(y + 2), here};
    const std::uint8_t *first = might_peak_.data(), *end = first + width_ - MARGIN;
    for (const std::uint8_t* at = first + MARGIN; at < end; ++at) {
        at = static_cast<const std::uint8_t*>(std::memchr(at, 1, end - at));
        if (at == nullptr) break;
        const std::int64_t x = at - first;
        const float value = here[x];
        // The nearest first, as most are no peak.
        const bool is_peak = std::all_of(rows.begin(), rows.end(), [&](const float* row) {
            return row[x - 1] <= value && row[x + 1] <= value && row[x - 2] <= value &&
                   row[x + 2] <= value && row[x] <= value;
        });
        if (is_peak) candidates_.push_back({value, {static_cast<float>(x), static_cast<float>(y)}});
    }
}

Curvature::Bends Curvature::bends(std::int64_t x, std::int64_t y) const {
    const float *here = smooth_.data() + y * width_ + x, *above = here - width_,
                *below = here + width_;
    return {here[-1] + here[1] - 2 * here[0], above[0] + below[0] - 2 * here[0],
            0.25F * (below[1] - below[-1] - above[1] + above[-1])};
}

bool Curvature::examine(Place place, float tolerance, Saddle& saddle) const {
    if (width_ == 0 || !std::isfinite(place.x) || !std::isfinite(place.y)) return false;
    const auto whole = [](float at, std::int64_t length) {
        return static_cast<std::int64_t>(
            std::clamp(std::nearbyint(at), 1.0F, static_cast<float>(length - 2)));
    };
    std::int64_t x = whole(place.x, width_), y = whole(place.y, height_);
    const float* here = smooth_.data() + y * width_ + x;
    const float slope_x = 0.5F * (here[1] - here[-1]),
                slope_y = 0.5F * (here[width_] - here[-width_]);
    Bends bend = bends(x, y);
    const float determinant = std::min(bend.xx * bend.yy - bend.xy * bend.xy, -1e-6F);
    float step_x = -(bend.yy * slope_x - bend.xy * slope_y) / determinant,
          step_y = -(bend.xx * slope_y - bend.xy * slope_x) / determinant;
    const float shorter = std::min(
        1.0F, LONGEST_STEP_PX / std::max(std::sqrt(step_x * step_x + step_y * step_y), 1e-9F));
    saddle.pixel = {static_cast<float>(x) + shorter * step_x,
                    static_cast<float>(y) + shorter * step_y};

    // Up along one axis and clearly down along the other.
    x = whole(saddle.pixel.x, width_), y = whole(saddle.pixel.y, height_);
    bend = bends(x, y);
    const float mean = 0.5F * (bend.xx + bend.yy), half = 0.5F * (bend.xx - bend.yy),
                radius = std::sqrt(half * half + bend.xy * bend.xy);
    const float up = mean + radius, down = radius - mean;
    if (!(up > LEAST_RATIO * down && down > LEAST_RATIO * up)) return false;

    std::array<float, SAMPLES> seen;
    sample_ring({smooth_.data(), height_, width_}, saddle.pixel, ring(), seen.data());
    // Its even part is that which half a turn leaves; power by Parseval's theorem.
    std::array<float, HALF> even;
    float sum = 0, squares = 0, odd = 0, alternating = 0;
    for (int k = 0; k < HALF; ++k) {
        even[k] = 0.5F * (seen[k] + seen[k + HALF]);
        sum += even[k];
        const float uneven = 0.5F * (seen[k] - seen[k + HALF]);
        odd += uneven * uneven;
        alternating += k % 2 ? -even[k] : even[k];
    }
    const float average = sum / HALF;
    for (const float value : even) squares += (value - average) * (value - average);
    const float last = (alternating / HALF) * (alternating / HALF);
    odd /= 2 * HALF;
    const float total = 0.5F * (squares / HALF + last) + odd + 1e-9F;
    const float diagonal = 0.70710678F;
    const float cosine = even[0] - even[4] + diagonal * (even[1] - even[3] - even[5] + even[7]);
    const float sine = even[2] - even[6] + diagonal * (even[1] + even[3] - even[5] - even[7]);
    const float second = (cosine * cosine + sine * sine) / (HALF * HALF);
    saddle.amplitude = 2 * std::sqrt(second);
    if (!(saddle.amplitude * tolerance > LEAST_AMPLITUDE && odd < tolerance * MOST_ODD * total &&
          second * tolerance > LEAST_SECOND * total))
        return false;

    // An edge is where the even part crosses the corner's own level. The Hessian would tell the
    // angles too, but where squares are small the next ones bend it by up to 30 degrees.
    const Picture<float> smooth{smooth_.data(), height_, width_};
    const float level = smooth.at(saddle.pixel.x, saddle.pixel.y);
    for (float& value : even) value -= level;
    const float light = crossing(even, true);
    float dark = crossing(even, false);
    if (light < 0 || dark < 0) return false;
    dark += dark < light ? PI : 0;
    saddle.directions[0] = light, saddle.directions[1] = dark;
    saddle.directions[2] = light + PI, saddle.directions[3] = dark + PI;
    return true;
}

}  // namespace trigpoint
