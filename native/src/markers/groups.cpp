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

// What a quadrilateral most likely is, among the columns of its scores.
struct Likeliest {
    std::int64_t quad, column;
    double score;
};

// Of those quadrilaterals that score at least `least`, the likeliest first, `most` at most.
std::vector<Likeliest> likeliest(const Array& scores, std::int64_t first, std::int64_t columns,
                                 double least, std::int64_t most) {
    std::vector<Likeliest> found;
    for (std::int64_t i = 0; i < scores.shape[0]; ++i) {
        const double* own = scores.as<const double>() + 4 * (i * scores.shape[1] + first);
        const double* best = std::max_element(own, own + columns);
        if (*best >= least) found.push_back({i, best - own, *best});
    }
    std::stable_sort(found.begin(), found.end(),
                     [](const auto& a, const auto& b) { return a.score > b.score; });
    if (static_cast<std::int64_t>(found.size()) > most)
        found.resize(static_cast<std::size_t>(most));
    return found;
}

Markers markers_of(const std::vector<Likeliest>& found, const Array& quads, const Array& layout) {
    Markers markers;
    for (const Likeliest& one : found) {
        const Corners seen = corners_in(quads, one.quad);
        Corners upright;
        for (int k = 0; k < 4; ++k) upright.row(k) = seen.row((one.column + k) % 4);
        markers.numbers.push_back(one.column / 4);
        markers.corners.push_back(upright);
        markers.printed.push_back(corners_in(layout, one.column / 4));
        markers.middles.push_back(markers.printed.back().colwise().mean());
        markers.scores.push_back(one.score);
    }
    return markers;
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

// (quads (n, 8), scores (n, all, 4) of each as each marker in each turn, the face's first among all
// markers, layout (m, 8) of its markers' corners, the least score, how many such quads there must
// be, and of how many the likeliest are looked at; numbers (n,), corners (n, 8) from the marker's
// top left on and quads (n,) of the members; ends and weights (g,)): how many boards these markers
// show, g at most; the members of one after the other, where each one's end, and the sums of their
// scores.
TRIGPOINT_KERNEL(tp_marker_groups) {
    const Array &quads = arguments[0].array, &scores = arguments[1].array,
                &layout = arguments[3].array;
    const std::int64_t first = arguments[2].whole;
    if (first < 0 || first > scores.shape[1] - layout.shape[0])
        throw std::invalid_argument("the face has other markers than were scored");
    if (layout.shape[0] == 0) return 0;
    const auto found = likeliest(scores, first, 4 * layout.shape[0], arguments[4].number,
                                 std::max<std::int64_t>(arguments[6].whole, 0));
    if (found.empty() || !(found[0].score >= LEAST_SEED) ||
        static_cast<std::int64_t>(found.size()) < arguments[5].whole)
        return 0;
    const Markers markers = markers_of(found, quads, layout);
    const Corners one = corners_in(layout, 0);
    const Gathering gathering(markers, (one.row(1) - one.row(0)).norm());
    const Array &ends = arguments[10].array, &weights = arguments[11].array;
    std::vector<char> is_free(markers.count(), 1);
    std::int64_t groups = 0, used = 0;
    for (std::size_t seed = 0; seed < std::min<std::size_t>(markers.count(), MOST_SEEDS); ++seed) {
        if (!(markers.scores[seed] >= LEAST_SEED) || groups == ends.shape[0]) break;
        if (!is_free[seed]) continue;
        const auto members = gathering.from(seed, is_free);
        double weight = 0;
        for (const std::size_t member : members)
            is_free[member] = 0, weight += markers.scores[member];
        const double least = members.size() > 1 ? LEAST_MEAN : LEAST_ALONE;
        if (!(weight / static_cast<double>(members.size()) >= least)) continue;
        for (const std::size_t member : members) {
            arguments[7].array.as<std::int64_t>()[used] = markers.numbers[member];
            Eigen::Map<Corners>(arguments[8].array.as<double>() + 8 * used) =
                markers.corners[member];
            arguments[9].array.as<std::int64_t>()[used++] = found[member].quad;
        }
        weights.as<double>()[groups] = weight;
        ends.as<std::int64_t>()[groups++] = used;
    }
    return groups;
}
