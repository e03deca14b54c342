// What Python asks of the search for markers: the dark quadrilaterals, and their cells.
#include <algorithm>
#include <cmath>

#include "markers/quads.hpp"

using namespace trigpoint;

namespace {

// Small markers are looked for in the picture, large ones and blurred ones at half its size: how
// many times smaller, and the threshold's window there, pixels. On rendered moving targets the two
// find as many markers as windows of 5 and 21 in the whole picture, at half the time.
constexpr std::int64_t PASSES = 2;
constexpr std::array<std::int64_t, PASSES> TIMES = {1, 2};
constexpr std::array<int, PASSES> WINDOWS = {5, 11};
// A picture whose longer side is of more pixels is looked at so many times smaller that it is not:
// twelve megapixels hold no detail of one pixel, and markers that are read have ten.
constexpr std::int64_t MOST_SIDE_PX = 2560;
// Of the picture's longer side; OpenCV's 0.03 loses markers of 4 pixels that still can be read.
constexpr double LEAST_PERIMETER = 0.02;
// Quadrilaterals whose places and sizes differ by less of their size are one.
constexpr double SAME_SHARE = 0.2;

struct Spot {
    Eigen::Vector2d middle;
    double size;

    explicit Spot(const Quad& quad) {
        Eigen::Vector2d low = quad[0], high = quad[0];
        middle = Eigen::Vector2d::Zero();
        for (const auto& corner : quad) {
            low = low.cwiseMin(corner), high = high.cwiseMax(corner);
            middle += 0.25 * corner;
        }
        size = (high - low).maxCoeff();
    }

    bool is(const Spot& other) const {
        const double most = SAME_SHARE * size;
        return std::abs(size - other.size) < most &&
               (middle - other.middle).cwiseAbs().maxCoeff() < most;
    }
};

struct Quads {
    QuadSearch search;
    std::vector<Quad> found;
    std::vector<Spot> spots;
};

}  // namespace

TRIGPOINT_OBJECT(tp_quad_search, Quads)

// (search, grey (h, w), longest side of the whole picture, passes, parts touching, quads (n, 8)):
// how many dark quadrilaterals there are, clockwise, pixels.
TRIGPOINT_KERNEL(tp_quads) {
    auto& [search, found, spots] = *static_cast<Quads*>(arguments[0].object);
    const Grey grey = Grey::of(arguments[1].array);
    constexpr std::int64_t LONGEST = std::int64_t{1} << 60;
    const std::int64_t longest = std::clamp(arguments[2].whole, std::max(grey.width, grey.height),
                                            LONGEST),
                       passes = std::clamp<std::int64_t>(arguments[3].whole, 0, PASSES);
    const bool parts_touching = arguments[4].whole != 0;
    auto quads = arguments[5].array.rows<8>();
    found.clear(), spots.clear();
    const std::int64_t base =
        std::max<std::int64_t>((longest + MOST_SIDE_PX - 1) / MOST_SIDE_PX, 1);
    for (std::int64_t pass = 0; pass < passes; ++pass) {
        const std::int64_t step = base * TIMES[pass];
        if (grey.width / step < 2 * WINDOWS[pass] || grey.height / step < 2 * WINDOWS[pass]) break;
        const Grey small = step > 1 ? search.shrunk(grey, step) : grey;
        const double least = LEAST_PERIMETER * static_cast<double>(longest / step);
        const double middle = static_cast<double>(step - 1) / 2;
        const std::size_t before = found.size();
        for (Quad quad : search.find(small, WINDOWS[pass], least, parts_touching)) {
            if (parts_touching) quad = straightened(small, quad);
            for (auto& corner : quad) corner = static_cast<double>(step) * corner.array() + middle;
            const Spot spot(quad);
            if (std::none_of(spots.begin(), spots.begin() + static_cast<std::ptrdiff_t>(before),
                             [&](const Spot& other) { return spot.is(other); }))
                found.push_back(quad), spots.push_back(spot);
        }
    }
    const auto count =
        std::min<Eigen::Index>(static_cast<Eigen::Index>(found.size()), quads.rows());
    for (Eigen::Index i = 0; i < count; ++i) {
        const Quad quad = straightened(grey, found[i]);
        for (int k = 0; k < 4; ++k) quads.row(i).segment<2>(2 * k) = quad[k];
    }
    return count;
}
