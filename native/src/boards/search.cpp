// What Python asks of the search for checkerboards: the grids of a picture, and a grid made whole.
#include <algorithm>
#include <stdexcept>

#include "boards/growth.hpp"

using namespace trigpoint;

namespace {

// Corners as they cross the border: place x and y, pixel x and y, and whether it is dark; (n, 5).
using Rows = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 5, Eigen::RowMajor>>;
constexpr double FARTHEST = 10'000;  // of a place

Grid grid_of(const Array& array) {
    const Rows rows = array.rows<5>();
    Grid grid;
    grid.reserve(rows.rows());
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
        if (!(rows.row(i).head<2>().array().abs() <= FARTHEST).all())
            throw std::invalid_argument("a grid's place is out of bounds");
        grid.push_back({static_cast<int>(rows(i, 0)),
                        static_cast<int>(rows(i, 1)),
                        {static_cast<float>(rows(i, 2)), static_cast<float>(rows(i, 3))},
                        rows(i, 4) != 0});
    }
    const Extent extent = Extent::of(grid);
    if (extent.width() > 4 * static_cast<int>(MOST_SADDLES) ||
        extent.height() > 4 * static_cast<int>(MOST_SADDLES))
        throw std::invalid_argument("a grid is wider than all corners of a picture");
    return grid;
}

// Puts a grid into rows from `first` on; how many it is.
Eigen::Index put(const Grid& grid, Rows rows, Eigen::Index first) {
    Eigen::Index row = first;
    for (const GridCorner& corner : grid) {
        if (row == rows.rows())
            throw std::length_error("a grid has more corners than there is room");
        rows.row(row++) << corner.x, corner.y, corner.pixel.x, corner.pixel.y, corner.is_dark;
    }
    return row - first;
}

}  // namespace

TRIGPOINT_OBJECT(tp_curvature, Curvature)

// (curvature, grey (h, w)): how many X corners the picture has.
TRIGPOINT_KERNEL(tp_saddles) {
    auto& curvature = *static_cast<Curvature*>(arguments[0].object);
    curvature.take(Grey::of(arguments[1].array));
    return static_cast<std::int64_t>(curvature.saddles().size());
}

// (curvature, corners (n, 5), sizes (m,)): how many grids the last picture's X corners form, the
// largest first; their corners one after the other, and how many each has.
TRIGPOINT_KERNEL(tp_grids) {
    auto& curvature = *static_cast<Curvature*>(arguments[0].object);
    const Rows rows = arguments[1].array.rows<5>();
    auto sizes = arguments[2].array.rows<1>();
    Eigen::Index first = 0;
    std::int64_t count = 0;
    for (const Grid& grid : find_grids(curvature.saddles())) {
        if (count == sizes.rows()) break;
        first += put(grid, rows, first);
        sizes(count++) = static_cast<double>(grid.size());
    }
    return count;
}

// (grid (n, 5), kept (n, 5)): the grid without its wild corners; how many are kept.
TRIGPOINT_KERNEL(tp_cleaned) {
    return put(cleaned(grid_of(arguments[0].array)), arguments[1].array.rows<5>(), 0);
}

// (curvature, grid (n, 5), longest, whole (m, 5)): the grid made whole; how many corners it has.
TRIGPOINT_KERNEL(tp_grown) {
    const auto& curvature = *static_cast<Curvature*>(arguments[0].object);
    const auto longest = static_cast<int>(std::clamp<std::int64_t>(arguments[2].whole, 0, 1000));
    const Grid whole = grown(grid_of(arguments[1].array), curvature, longest);
    return put(whole, arguments[3].array.rows<5>(), 0);
}
