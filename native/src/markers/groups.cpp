// Markers that may be right, put together to boards: those that agree on where the board lies.
#include <algorithm>
#include <optional>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "registration/plane_fitting.hpp"

using namespace trigpoint;

namespace {

// Correlations of a marker's cells: to start a board, on the mean of its markers, and of one all
// alone. Dark clutter reaches 0.6 with the best of a few hundred markers, never twice at agreeing
// places.
constexpr double LEAST_SEED = 0.6, LEAST_MEAN = 0.6, LEAST_ALONE = 0.8;
// How far a member's corners may lie from where the others put them, of the marker's side,
constexpr double NEAR = 0.3;
// and how far a new member may be from the nearest old one, of the marker's side.
constexpr double STEP = 3.5;
// How many markers are tried as the start of a board.
constexpr int MOST_SEEDS = 64;

using Corners = Eigen::Matrix<double, 4, 2, Eigen::RowMajor>;

// What quadrilaterals could be as markers of one face, the likeliest first.
struct Markers {
    std::vector<std::int64_t> numbers;
    std::vector<Corners> corners, printed;    // pixels; on the face
    std::vector<Eigen::RowVector2d> middles;  // of those on the face
    std::vector<double> scores;

    std::size_t count() const { return numbers.size(); }
};

Corners corners_in(const Array& array, std::int64_t row) {
    return Eigen::Map<const Corners>(array.as<const double>() + 8 * row);
}

// A homography to pixels, fitted to some markers' corners.
std::optional<PlanarFit> fitted(const Markers& markers, const std::vector<std::size_t>& members) {
    Points points(4 * members.size(), 2), pixels(4 * members.size(), 2);
    for (std::size_t i = 0; i < members.size(); ++i) {
        points.middleRows<4>(4 * static_cast<Eigen::Index>(i)) = markers.printed[members[i]];
        pixels.middleRows<4>(4 * static_cast<Eigen::Index>(i)) = markers.corners[members[i]];
    }
    const Eigen::Vector2d most = pixels.colwise().maxCoeff();
    return fit_plane(points, pixels, PlanarFit::of_size(most.x(), most.y()), false, false);
}

// How far a marker's corners lie from where a fit puts them on the mean, of their side there.
double off_by(const PlanarFit& fit, const Markers& markers, std::size_t marker) {
    Corners expected;
    for (int k = 0; k < 4; ++k)
        expected.row(k) = fit.straight(markers.printed[marker].row(k).transpose());
    const double side = std::max((expected.row(2) - expected.row(0)).norm(), 1e-9) / std::sqrt(2.0);
    return (markers.corners[marker] - expected).rowwise().norm().mean() / side;
}

// The seed and all free markers that agree with it, the nearest for each number.
class Gathering {
public:
    Gathering(const Markers& markers, double side) : markers_(markers), reach_(STEP * side) {}

    std::vector<std::size_t> from(std::size_t seed, const std::vector<char>& is_free) const {
        std::vector<std::size_t> members = {seed};
        for (;;) {
            // A fit costs more than to see that there is nothing to hold against it.
            const auto beside = all_beside(members, is_free);
            if (beside.empty()) break;
            const auto fit = fitted(markers_, members);
            if (!fit) break;
            const auto added = agreeing(*fit, beside);
            if (added.empty()) break;
            members.insert(members.end(), added.begin(), added.end());
        }
        return members;
    }

private:
    bool is_beside(std::size_t marker, const std::vector<std::size_t>& members) const {
        const Eigen::RowVector2d& middle = markers_.middles[marker];
        bool is_near = false;
        for (const std::size_t member : members) {
            if (markers_.numbers[member] == markers_.numbers[marker]) return false;
            is_near = is_near || (markers_.middles[member] - middle).norm() < reach_;
        }
        return is_near;
    }

    std::vector<std::size_t> all_beside(const std::vector<std::size_t>& members,
                                        const std::vector<char>& is_free) const {
        std::vector<std::size_t> beside;
        for (std::size_t i = 0; i < markers_.count(); ++i)
            if (is_free[i] && is_beside(i, members)) beside.push_back(i);
        return beside;
    }

    std::vector<std::size_t> agreeing(const PlanarFit& fit,
                                      const std::vector<std::size_t>& beside) const {
        std::vector<std::size_t> best;
        std::vector<double> nearest;
        for (const std::size_t i : beside) {
            const double off = off_by(fit, markers_, i);
            if (!(off < NEAR)) continue;
            const auto same = std::find_if(best.begin(), best.end(), [&](std::size_t other) {
                return markers_.numbers[other] == markers_.numbers[i];
            });
            if (same == best.end()) {
                best.push_back(i), nearest.push_back(off);
            } else if (off < nearest[static_cast<std::size_t>(same - best.begin())]) {
                nearest[static_cast<std::size_t>(same - best.begin())] = off;
                *same = i;
            }
        }
        return best;
    }

    const Markers& markers_;
    double reach_;
};

}  // namespace

// (numbers (n,), corners (n, 8) pixels, scores (n,), the likeliest first, layout (m, 8) of all
// markers' corners on the face, members (n,), ends (g,)): how many boards these markers show, g at
// most; the markers of one after the other, and where each one's end.
TRIGPOINT_KERNEL(tp_marker_groups) {
    const Array &numbers = arguments[0].array, &layout = arguments[3].array;
    const auto scores = arguments[2].array.rows<1>();
    if (scores.rows() == 0 || !(scores(0) >= LEAST_SEED)) return 0;
    Markers markers;
    for (std::int64_t i = 0; i < numbers.shape[0]; ++i) {
        const std::int64_t number = numbers.as<const std::int64_t>()[i];
        if (number < 0 || number >= layout.shape[0])
            throw std::invalid_argument("the face has no marker of that number");
        markers.numbers.push_back(number);
        markers.corners.push_back(corners_in(arguments[1].array, i));
        markers.printed.push_back(corners_in(layout, number));
        markers.middles.push_back(markers.printed.back().colwise().mean());
        markers.scores.push_back(scores(i));
    }
    if (layout.shape[0] == 0) return 0;
    const Corners first = corners_in(layout, 0);
    const Gathering gathering(markers, (first.row(1) - first.row(0)).norm());
    auto* members = arguments[4].array.as<std::int64_t>();
    auto* ends = arguments[5].array.as<std::int64_t>();
    std::vector<char> is_free(markers.count(), 1);
    std::int64_t groups = 0, used = 0;
    for (std::size_t seed = 0; seed < std::min<std::size_t>(markers.count(), MOST_SEEDS); ++seed) {
        if (!(markers.scores[seed] >= LEAST_SEED) || groups == arguments[5].array.shape[0]) break;
        if (!is_free[seed]) continue;
        const auto found = gathering.from(seed, is_free);
        double weight = 0;
        for (const std::size_t member : found)
            is_free[member] = 0, weight += markers.scores[member];
        const double least = found.size() > 1 ? LEAST_MEAN : LEAST_ALONE;
        if (!(weight / static_cast<double>(found.size()) >= least)) continue;
        for (const std::size_t member : found) members[used++] = static_cast<std::int64_t>(member);
        ends[groups++] = used;
    }
    return groups;
}
