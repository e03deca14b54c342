// What Python asks of the search for checkerboards: the grids of a picture, and a grid made whole.
#include <algorithm>
#include <stdexcept>

#include "boards/evidence.hpp"
#include "boards/growth.hpp"
#include "boards/placement.hpp"
#include "registration/plane_fitting.hpp"

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

constexpr double MOST_SIDE = 1000;  // of a board, corners

BoardShape shape_of(double columns, double rows, double is_inverted) {
    if (!(columns >= 1 && rows >= 1 && columns <= MOST_SIDE && rows <= MOST_SIDE))
        throw std::invalid_argument("a board has 1 to 1000 corners each way");
    return {static_cast<int>(columns), static_cast<int>(rows), is_inverted != 0};
}

// As a fit crosses the border, of a board of such squares, from its places to the picture.
PlanarFit of_places(const Array& packed, double square) {
    PlanarFit fit = PlanarFit::unpacked(packed.as<double>());
    fit.homography.leftCols<2>() *= square;
    fit.bend.middle /= square, fit.bend.half /= square;
    return fit;
}

// Through a grid's corners, from their places to the picture.
std::optional<PlanarFit> fit_of_places(const Grid& grid, double width, double height,
                                       double enough_px) {
    const auto count = static_cast<Eigen::Index>(grid.size());
    Points places(count, 2), pixels(count, 2);
    for (Eigen::Index i = 0; i < count; ++i) {
        const GridCorner& corner = grid[static_cast<std::size_t>(i)];
        places.row(i) << corner.x, corner.y;
        pixels.row(i) << corner.pixel.x, corner.pixel.y;
    }
    return settled_fit(places, pixels, PlanarFit::of_size(width, height), false, enough_px);
}

}  // namespace

TRIGPOINT_OBJECT(tp_curvature, Curvature)

// (curvature, grey (h, w)): how many X corners the picture has.
TRIGPOINT_KERNEL(tp_saddles) {
    auto& curvature = *static_cast<Curvature*>(arguments[0].object);
    curvature.take(Grey::of(arguments[1].array));
    return static_cast<std::int64_t>(curvature.saddles().size());
}

// (curvature, finer curvature): how many X corners the other's picture has at half its size.
TRIGPOINT_KERNEL(tp_half_saddles) {
    auto& curvature = *static_cast<Curvature*>(arguments[0].object);
    if (arguments[0].object == arguments[1].object)
        throw std::invalid_argument("a picture is not halved in its own place");
    curvature.take_half(*static_cast<const Curvature*>(arguments[1].object));
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

// (grid (n, 5), shapes (k, 3): columns, rows and whether inverted, width, height, fit, its square
// or 0 without a fit, least share, enough px, ids (n,), which (2): shape and score): of these
// boards the one that lies best on the grid; how many of its corners the grid has, 0 where none
// does.
TRIGPOINT_KERNEL(tp_placed) {
    const Grid grid = grid_of(arguments[0].array);
    if (grid.empty()) return 0;
    const auto shapes = arguments[1].array.rows<3>();
    const double width = arguments[2].number, height = arguments[3].number;
    const double square = arguments[5].number;
    std::optional<PlanarFit> fit;
    bool is_fitted = square > 0;
    if (is_fitted) fit = of_places(arguments[4].array, square);
    const FitOfPlaces fit_of = [&] {
        if (!is_fitted) fit = fit_of_places(grid, width, height, arguments[7].number);
        is_fitted = true;
        return fit;
    };
    auto ids = arguments[8].array.rows<1>();
    auto which = arguments[9].array.rows<1>();
    std::int64_t count = 0;
    which(1) = -1e9;
    for (Eigen::Index i = 0; i < shapes.rows(); ++i) {
        const BoardShape shape = shape_of(shapes(i, 0), shapes(i, 1), shapes(i, 2));
        const auto found = placed(grid, shape, width, height, arguments[6].number, fit_of);
        if (!found || found->score <= which(1)) continue;
        which << static_cast<double>(i), found->score;
        for (Eigen::Index k = 0; k < ids.size(); ++k)
            ids(k) = found->ids[static_cast<std::size_t>(k)];
        count = (ids.array() >= 0).count();
    }
    return count;
}

// (grey (h, w), columns, rows, square, fit, ids (n,), pixels (n, 2), evidence (5): of the board,
// and of its ends): 1 where no doubt is left that it is there.
TRIGPOINT_KERNEL(tp_weighed) {
    const Grey grey = Grey::of(arguments[0].array);
    if (grey.width < 1 || grey.height < 1) return 0;
    const BoardShape shape = shape_of(static_cast<double>(arguments[1].whole),
                                      static_cast<double>(arguments[2].whole), 0);
    const PlanarFit fit = of_places(arguments[4].array, arguments[3].number);
    const Array& numbers = arguments[5].array;
    const auto rows = arguments[6].array.rows<2>();
    std::vector<int> ids;
    std::vector<Eigen::Vector2d> pixels;
    for (std::int64_t i = 0; i < numbers.shape[0]; ++i) {
        const std::int64_t id = numbers.as<const std::int64_t>()[i];
        if (!(id >= 0 && id < shape.count()))
            throw std::invalid_argument("a corner is none of the board's");
        ids.push_back(static_cast<int>(id));
        pixels.emplace_back(rows.row(i));
    }
    const Evidence found = weighed(grey, shape, fit, ids, pixels);
    auto told = arguments[7].array.rows<1>();
    told(0) = found.board;
    for (int side = 0; side < 4; ++side)
        told(side + 1) = found.ends[static_cast<std::size_t>(side)];
    return found.is_board();
}
