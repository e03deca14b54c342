#include "registration/registration.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace trigpoint {
namespace {

constexpr int ROUNDS = 6, ROUGH_ROUNDS = 2;
// And more, for those corners alone, if few, that have not settled by then: boards curl.
constexpr int LATE_ROUNDS = 4;
constexpr std::size_t MOST_LATE = 8;
// By how many corners a face is first brought near, and its blur learnt.
constexpr std::size_t ROUGH_CORNERS = 16;
// By how much a picture is softened where corners are off by more than its own blur, pixel².
constexpr double SOFTENING = 1.6;
// A step is trusted so far, pixels.
constexpr double LONGEST_STEP_PX = 1.0, LONGEST_ROUGH_STEP_PX = 2.5;
// Where most steps are shorter, what is left of them is of no account.
constexpr double NEAR_STEP_PX = 0.5;
// Steps so short change nothing in how corners look.
constexpr double STILL_STEP_PX = 0.3;
// What is left after a step is a fiftieth of it: after such steps, if few corners step further than
// SETTLED_STEP_PX, the face needs no other round. After such far ones it is not near yet.
constexpr double SMALL_STEP_PX = 0.12, FAR_STEP_PX = 0.6, SETTLED_STEP_PX = 0.15;
// Steps that do not become so much shorter lead nowhere: the face is not there.
constexpr double LEAST_SHORTER = 0.8;
// A corner may lie so far beside the middle of its patch, pixels, before another part of the
// picture is taken: in another one it is found a little elsewhere, and would step to and fro.
constexpr double MOST_ASIDE_PX = 0.6;
constexpr double SMALL_CHANGE = 0.1;  // of the blur's numbers
constexpr int AROUND_PX = MOST_HALF_PX + 6;
constexpr double NONE = std::numeric_limits<double>::quiet_NaN();

Eigen::Vector2d rounded(const Eigen::Vector2d& pixel) {
    return {std::nearbyint(pixel.x()), std::nearbyint(pixel.y())};
}

// A pixel so far out comes from a fit that has run away; nothing is looked for there.
bool is_sane(const Eigen::Vector2d& pixel) { return pixel.cwiseAbs().maxCoeff() < 1e6; }

// The plane through the clear corners, and all of them, the others where it has them.
void refit(PlanarFit& fit, const Points& points, std::vector<Eigen::Vector2d>& pixels,
           const std::vector<char>& clear) {
    std::vector<std::size_t> which;
    for (std::size_t i = 0; i < pixels.size(); ++i)
        if (clear[i]) which.push_back(i);
    const auto count = static_cast<Eigen::Index>(which.size());
    Points some(count, 2), where(count, 2);
    for (Eigen::Index k = 0; k < count; ++k) {
        some.row(k) = points.row(static_cast<Eigen::Index>(which[k]));
        where.row(k) = pixels[which[k]].transpose();
    }
    SoundLimits limits;
    limits.least_share.assign(which.size(), 0.04);  // real boards are not flat to better than this
    std::vector<char> sound;
    const auto better = sound_corners(some, where, fit, true, limits, sound);
    if (!better) return;
    std::vector<char> kept(pixels.size(), 0);
    for (std::size_t k = 0; k < which.size(); ++k) kept[which[k]] = sound[k];
    for (std::size_t i = 0; i < pixels.size(); ++i)
        if (!kept[i]) pixels[i] = better->project(points.row(static_cast<Eigen::Index>(i)));
    fit = *better;
}

Points points_of(const CornerPattern& pattern, const std::vector<int>& ids) {
    Points points(static_cast<Eigen::Index>(ids.size()), 2);
    for (std::size_t i = 0; i < ids.size(); ++i)
        points.row(static_cast<Eigen::Index>(i)) = pattern.points.row(ids[i]);
    return points;
}

// So many of `count`, from all over, the first and the last too.
std::vector<std::size_t> spread(std::size_t count) {
    std::vector<std::size_t> which(std::min(count, ROUGH_CORNERS));
    for (std::size_t i = 0; i < which.size() && count > 1; ++i)
        which[i] = static_cast<std::size_t>(
            std::nearbyint(double(i) * double(count - 1) / double(which.size() - 1)));
    return which;
}

std::vector<char> clear_of(const Alignment& found) {
    std::vector<char> clear;
    for (const auto& corner : found.corners) clear.push_back(corner.is_clear);
    return clear;
}

// How far a picture is softened, pixels; lines of it side by side, or a line and its next places.
constexpr int REACH = 4;
using Lines = std::array<const float*, 2 * REACH + 1>;

// The weighted sum of lines, by how far they are from the middle one.
TRIGPOINT_WIDE
void weigh(const Lines& lines, const std::array<float, REACH + 1>& shares, float* __restrict to,
           std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x) {
        float sum = shares[0] * lines[REACH][x];
        for (int k = 1; k <= REACH; ++k)
            sum += shares[k] * (lines[REACH - k][x] + lines[REACH + k][x]);
        to[x] = sum;
    }
}

// The part of a picture about pixels, blurred by SOFTENING; it lies in `memory`.
PartOfPicture softened(const Grey& grey, const std::vector<Eigen::Vector2d>& pixels,
                       std::vector<std::uint8_t>& memory) {
    Eigen::Vector2d low = pixels[0], high = pixels[0];
    for (const auto& pixel : pixels) low = low.cwiseMin(pixel), high = high.cwiseMax(pixel);
    const auto bounded = [](double at, std::int64_t length) {
        return static_cast<std::int64_t>(std::clamp(at, 0.0, static_cast<double>(length)));
    };
    PartOfPicture part;
    part.left = bounded(std::floor(low.x()) - AROUND_PX, grey.width);
    part.top = bounded(std::floor(low.y()) - AROUND_PX, grey.height);
    const std::int64_t right = bounded(std::ceil(high.x()) + AROUND_PX, grey.width),
                       bottom = bounded(std::ceil(high.y()) + AROUND_PX, grey.height);
    const std::int64_t width = right - part.left, height = bottom - part.top;
    if (width <= 0 || height <= 0) return part;
    std::array<float, REACH + 1> gauss;
    float sum = 0;
    for (int k = 0; k <= REACH; ++k) {
        gauss[k] = static_cast<float>(std::exp(-0.5 * k * k / SOFTENING));
        sum += (k == 0 ? 1 : 2) * gauss[k];
    }
    for (float& share : gauss) share /= sum;
    std::vector<float> across(static_cast<std::size_t>(width * height)), line(width + 2 * REACH);
    Lines lines;
    for (std::int64_t y = 0; y < height; ++y) {
        const std::uint8_t* from = grey.row(part.top + y) + part.left;
        std::fill_n(std::copy_n(from, width, std::fill_n(line.begin(), REACH, from[0])), REACH,
                    from[width - 1]);
        for (std::int64_t k = 0; k <= 2 * REACH; ++k) lines[k] = line.data() + k;
        weigh(lines, gauss, across.data() + y * width, width);
    }
    memory.resize(static_cast<std::size_t>(width * height));
    for (std::int64_t y = 0; y < height; ++y) {
        for (std::int64_t k = 0; k <= 2 * REACH; ++k)
            lines[k] =
                across.data() + std::clamp<std::int64_t>(y + k - REACH, 0, height - 1) * width;
        weigh(lines, gauss, line.data(), width);
        for (std::int64_t x = 0; x < width; ++x)
            memory[y * width + x] = static_cast<std::uint8_t>(line[x] + 0.5F);
    }
    part.grey = {memory.data(), height, width};
    return part;
}

// Brings a fit to within a pixel, in the softened picture, by corners from all over the face, the
// first and the last too; whether it still is far.
bool approach(const Grey& grey, const CornerPattern& pattern, PlanarFit& fit,
              const std::vector<int>& all, const Blur& blur) {
    Corners corners;
    for (const std::size_t i : spread(all.size())) corners.ids.push_back(all[i]);
    const Points points = points_of(pattern, corners.ids);
    for (const int id : corners.ids) corners.pixels.push_back(fit.project(pattern.points.row(id)));
    std::vector<std::uint8_t> memory;
    const PartOfPicture soft = softened(grey, corners.pixels, memory);
    for (int round = 0; round < ROUGH_ROUNDS; ++round) {
        if (!std::all_of(corners.pixels.begin(), corners.pixels.end(), is_sane)) return true;
        corners.nearest.clear();
        for (const auto& pixel : corners.pixels) corners.nearest.push_back(rounded(pixel));
        const Alignment found = aligned(soft, pattern, fit, corners, blur.softened(SOFTENING),
                                        LONGEST_ROUGH_STEP_PX, std::nullopt, true);
        for (std::size_t i = 0; i < corners.ids.size(); ++i)
            if (found.corners[i].is_clear) corners.pixels[i] += found.corners[i].step;
        refit(fit, points, corners.pixels, clear_of(found));
        if (found.usual_length() < NEAR_STEP_PX) return false;
    }
    return true;
}

// What is known of a face between the rounds. `starts`: where corners were found before, if that is
// further than a step from where the fit has them: within one the fit knows better.
struct Face {
    const PartOfPicture& part;
    const CornerPattern& pattern;
    Corners corners;
    Points points;
    std::vector<Eigen::Vector2d> starts;
    PlanarFit fit;
    Blur blur;

    // A round for some of the corners: the clear ones are moved. Each keeps the part of the picture
    // that it is looked for in while it lies near its middle.
    Alignment moved(const std::vector<std::size_t>& which, const std::optional<Usual>& usual,
                    bool is_far) {
        Corners some;
        for (const std::size_t i : which) {
            if (!((corners.pixels[i] - corners.nearest[i]).cwiseAbs().maxCoeff() <= MOST_ASIDE_PX))
                corners.nearest[i] = rounded(corners.pixels[i]);
            some.ids.push_back(corners.ids[i]);
            some.pixels.push_back(corners.pixels[i]);
            some.nearest.push_back(corners.nearest[i]);
        }
        Alignment found = aligned(part, pattern, fit, some, blur, LONGEST_STEP_PX, usual, is_far);
        for (std::size_t k = 0; k < which.size(); ++k)
            if (found.corners[k].is_clear) corners.pixels[which[k]] += found.corners[k].step;
        return found;
    }

    // The plane through the clear corners; the others where they were found, or where that has
    // them.
    void take_plane(const std::vector<char>& clear) {
        refit(fit, points, corners.pixels, clear);
        for (std::size_t i = 0; i < clear.size(); ++i)
            if (!clear[i] && starts[i].allFinite()) corners.pixels[i] = starts[i];
    }
};

bool is_near(const Alignment& found) {
    std::size_t far = 0;
    for (const auto& corner : found.corners)
        far += corner.is_clear && corner.step.norm() > SETTLED_STEP_PX;
    return found.usual_length() < SMALL_STEP_PX && far <= MOST_LATE &&
           found.change.cwiseAbs().maxCoeff() < SMALL_CHANGE;
}

}  // namespace

Registration registered(const Grey& grey, const CornerPattern& pattern, const PlanarFit& start,
                        const std::vector<int>& ids, const std::vector<Eigen::Vector2d>& starts,
                        const Blur& blur, bool is_rough) {
    const std::size_t n = ids.size();
    const PartOfPicture whole{grey};
    Face face{whole, pattern, {ids, {}, {}}, points_of(pattern, ids), {}, start, blur};
    bool is_far = is_rough && approach(grey, pattern, face.fit, ids, blur);
    std::vector<std::size_t> every(n);
    for (std::size_t i = 0; i < n; ++i) {
        every[i] = i;
        Eigen::Vector2d pixel = face.fit.project(pattern.points.row(ids[i]));
        const bool is_away = !starts.empty() && (starts[i] - pixel).norm() > LONGEST_STEP_PX;
        face.starts.push_back(is_away ? starts[i] : Eigen::Vector2d(NONE, NONE));
        if (is_away) pixel = starts[i];
        face.corners.pixels.push_back(is_sane(pixel) ? pixel : Eigen::Vector2d(-1e3, -1e3));
        face.corners.nearest.push_back(rounded(face.corners.pixels.back()));
    }
    // Where no picture before has shown its blur, most corners need no other round once that is
    // known from a few.
    const bool is_new = !starts.empty();
    if (is_new && n > 2 * ROUGH_CORNERS)
        face.blur = face.moved(spread(n), std::nullopt, is_far).blur;
    Alignment found = face.moved(every, std::nullopt, is_far);
    face.blur = found.blur;
    double usual = found.usual_length(), before = std::numeric_limits<double>::infinity();
    for (int round = 1; round < ROUNDS; ++round) {
        const bool is_vain = usual > STILL_STEP_PX && usual > LEAST_SHORTER * before;
        const std::vector<char> clear = clear_of(found);
        const bool has_lost = std::count(clear.begin(), clear.end(), 0) > 0;
        // Those of a new face that are lost are looked for once more, where the others say.
        const bool is_done = is_near(found) && !is_far && !(is_new && round == 1 && has_lost);
        if (is_done || is_vain || !found.has_clear()) break;
        is_far = usual > FAR_STEP_PX;
        if (usual > STILL_STEP_PX || has_lost) face.take_plane(clear);
        if (!std::all_of(face.corners.pixels.begin(), face.corners.pixels.end(), is_sane)) break;
        found = face.moved(every, std::nullopt, is_far);
        face.blur = found.blur;
        before = usual, usual = found.usual_length();
    }

    // More rounds for those corners alone that still move.
    for (int round = 0; round < LATE_ROUNDS; ++round) {
        std::vector<std::size_t> late;
        for (std::size_t i = 0; i < n; ++i) {
            const auto& corner = found.corners[i];
            if (corner.is_clear && corner.step.norm() > SETTLED_STEP_PX) late.push_back(i);
        }
        if (late.empty() || late.size() > MOST_LATE) break;
        const Alignment again = face.moved(late, found.usual, false);
        for (std::size_t k = 0; k < late.size(); ++k) found.corners[late[k]] = again.corners[k];
    }
    Registration made{face.corners.pixels, {}, {}, {}, face.blur, face.fit};
    for (const auto& corner : found.corners) {
        // A corner that still moves has not found its place.
        made.is_clear.push_back(corner.is_clear && corner.step.norm() <= SETTLED_STEP_PX);
        made.is_whole.push_back(corner.is_whole);
        made.sigma.push_back(corner.sigma);
    }
    return made;
}

}  // namespace trigpoint
