// Where a ChArUco board ends, against where its file says.
#include <algorithm>
#include <array>
#include <stdexcept>
#include <vector>

#include "image/picture.hpp"
#include "registration/planar_fit.hpp"

using namespace trigpoint;

namespace {

// Squares of one line: the file's own may be lost to a glare one at a time.
constexpr int LEAST_GONE = 2, LINES = 8;

struct Line {
    int count = 0, light = 0, dark = 0;
};

float seen_at(const Grey& grey, const PlanarFit& fit, const double* place, double margin,
              bool& is_inside) {
    const Eigen::Vector2d pixel = fit.project({place[0], place[1]});
    is_inside = is_inside && pixel.x() > margin && pixel.y() > margin &&
                pixel.x() < static_cast<double>(grey.width) - 1 - margin &&
                pixel.y() < static_cast<double>(grey.height) - 1 - margin;
    if (!pixel.allFinite()) return 0;
    return grey.at(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()));
}

}  // namespace

// (grey (h, w), fit, corners (k,) that are seen, what is beside each corner (c, 8), least contrast,
// places (n, 12), the line of each (n,), whether it is looked at where a corner is seen (n, c)): 1
// where an outer line, 2 k, is light as far as it is seen, and the inner one, 2 k + 1, as printed.
TRIGPOINT_KERNEL(tp_ends_early) {
    const Grey grey = Grey::of(arguments[0].array);
    const PlanarFit fit = PlanarFit::unpacked(arguments[1].array.as<double>());
    const Array &corners = arguments[2].array, &beside = arguments[3].array,
                &places = arguments[5].array, &reached = arguments[7].array;
    if (grey.width < 1 || grey.height < 1 || corners.shape[0] == 0) return 0;
    std::vector<float> darker, lighter;
    bool is_inside = true;
    for (std::int64_t i = 0; i < corners.shape[0]; ++i) {
        const std::int64_t corner = corners.as<const std::int64_t>()[i];
        if (!(corner >= 0 && corner < beside.shape[0]))
            throw std::invalid_argument("a corner is none of the board's");
        std::array<float, 4> values;
        for (int k = 0; k < 4; ++k)
            values[k] =
                seen_at(grey, fit, beside.as<const double>() + 8 * corner + 2 * k, 0, is_inside);
        std::sort(values.begin(), values.end());
        darker.push_back(values[1]), lighter.push_back(values[2]);
    }
    const float dark = median(darker), light = median(lighter), middle = (dark + light) / 2;
    if (!(light - dark > arguments[4].number)) return 0;
    std::array<Line, LINES> lines{};
    for (std::int64_t i = 0; i < places.shape[0]; ++i) {
        const std::uint8_t* near = reached.as<const std::uint8_t>() + i * reached.shape[1];
        const std::int64_t line = arguments[6].array.as<const std::int64_t>()[i];
        if (!(line >= 0 && line < LINES)) throw std::invalid_argument("there are eight lines");
        const auto* seen = corners.as<const std::int64_t>();
        if (std::none_of(seen, seen + corners.shape[0], [&](auto id) { return near[id] != 0; }))
            continue;
        is_inside = true;
        int above = 0, below = 0;
        for (int k = 0; k < 6; ++k) {
            const float value =
                seen_at(grey, fit, places.as<const double>() + 12 * i + 2 * k, 1, is_inside);
            above += value > middle, below += value < middle;
        }
        if (!is_inside) continue;
        ++lines[line].count, lines[line].light += above == 6, lines[line].dark += below == 6;
    }
    for (int k = 0; k < LINES; k += 2) {
        const Line &outer = lines[k], &inner = lines[k + 1];
        if (outer.count >= LEAST_GONE && outer.light == outer.count && inner.count > 0 &&
            inner.dark == inner.count)
            return 1;
    }
    return 0;
}
