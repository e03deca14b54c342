// Which places lie near others, and how long ways over a grid are.
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>
#include <stdexcept>
#include <utility>
#include <vector>

#include "border.hpp"

using namespace trigpoint;

namespace {

using Cell = std::array<std::int64_t, 3>;
using Point = std::array<double, 3>;

// Cells are counted exactly up to here, with neighbours on all sides.
constexpr double FARTHEST = 1e15;
// Of a cell's side to the distance: places that are so far apart lie in neighbouring cells in spite
// of rounding.
constexpr double ROOM = 1 + 1e-9;

Point point_of(const Array& places, std::int64_t row) {
    Point point{};
    for (std::int64_t axis = 0; axis < places.shape[1]; ++axis)
        point[static_cast<std::size_t>(axis)] = places.as<double>()[row * places.shape[1] + axis];
    return point;
}

// The cell of a point; false where it is in none that can be counted.
bool cell_of(const Point& point, double side, Cell& cell) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const double count = std::floor(point[axis] / side);
        if (!(std::abs(count) < FARTHEST)) return false;
        cell[axis] = static_cast<std::int64_t>(count);
    }
    return true;
}

double squared_distance(const Point& one, const Point& other) {
    double sum = 0;
    for (std::size_t axis = 0; axis < 3; ++axis)
        sum += (one[axis] - other[axis]) * (one[axis] - other[axis]);
    return sum;
}

// Places in order of their cells, as wide as the distance that is asked for.
class Grid {
public:
    Grid(const Array& places, double distance) : distance_(distance), side_(distance * ROOM) {
        for (std::int64_t row = 0; row < places.shape[0]; ++row) {
            const Point point = point_of(places, row);
            Cell cell;
            if (cell_of(point, side_, cell)) places_.emplace_back(cell, point);
        }
        std::sort(places_.begin(), places_.end());
    }
    bool has_near(const Point& point) const {
        Cell cell;
        if (!cell_of(point, side_, cell)) return false;
        for (std::int64_t x = cell[0] - 1; x <= cell[0] + 1; ++x)
            for (std::int64_t y = cell[1] - 1; y <= cell[1] + 1; ++y)
                if (column_has_near(point, {x, y, cell[2] - 1})) return true;
        return false;
    }

private:
    using Place = std::pair<Cell, Point>;

    // Of three cells, one behind the other.
    bool column_has_near(const Point& point, const Cell& first) const {
        const auto before = [](const Place& place, const Cell& cell) { return place.first < cell; };
        const Cell end{first[0], first[1], first[2] + 3};
        auto place = std::lower_bound(places_.begin(), places_.end(), first, before);
        for (; place != places_.end() && place->first < end; ++place)
            if (squared_distance(place->second, point) <= distance_ * distance_) return true;
        return false;
    }

    double distance_, side_;
    std::vector<Place> places_;
};

using Square = std::array<std::int64_t, 2>;

}  // namespace

// (points (n, a) and places (m, a) with at most three axes, distance, near (n,)): which points are
// within the distance of a place; how many.
TRIGPOINT_KERNEL(tp_near) {
    const Array& points = arguments[0].array;
    const double distance = arguments[2].number;
    if (points.shape[1] > 3) throw std::invalid_argument("places have at most three axes");
    if (!(distance > 0)) throw std::invalid_argument("the distance must be above 0");
    const Grid grid(arguments[1].array, distance);
    auto* near = arguments[3].array.as<std::uint8_t>();
    std::int64_t count = 0;
    for (std::int64_t row = 0; row < points.shape[0]; ++row)
        count += near[row] = grid.has_near(point_of(points, row));
    return count;
}

// (squares (n, 2) in order of rows, start, lengths (n,)): the length of the shortest way from a
// square to each, by steps to any of its eight neighbours (Dijkstra, 1959), in sides of a square;
// infinite where there is none.
TRIGPOINT_KERNEL(tp_paths) {
    const Array& given = arguments[0].array;
    const auto count = static_cast<std::size_t>(given.shape[0]);
    const std::int64_t start = arguments[1].whole;
    if (start < 0 || start >= given.shape[0]) throw std::invalid_argument("no such square");
    std::vector<Square> squares(count);
    for (std::size_t row = 0; row < count; ++row) {
        const std::int64_t* const square = given.as<std::int64_t>() + 2 * row;
        squares[row] = {square[0], square[1]};
        if (std::max(std::abs(static_cast<double>(square[0])),
                     std::abs(static_cast<double>(square[1]))) > FARTHEST)
            throw std::invalid_argument("a square is too far away");
        if (row > 0 && squares[row] <= squares[row - 1])
            throw std::invalid_argument("squares must be in order, each once");
    }
    double* const lengths = arguments[2].array.as<double>();
    std::fill(lengths, lengths + count, std::numeric_limits<double>::infinity());
    using Reached = std::pair<double, std::size_t>;
    std::priority_queue<Reached, std::vector<Reached>, std::greater<Reached>> next;
    next.emplace(lengths[start] = 0, static_cast<std::size_t>(start));
    while (!next.empty()) {
        const auto [length, row] = next.top();
        next.pop();
        if (length > lengths[row]) continue;
        for (std::int64_t x = -1; x <= 1; ++x) {
            for (std::int64_t y = -1; y <= 1; ++y) {
                const Square there{squares[row][0] + x, squares[row][1] + y};
                const auto found = std::lower_bound(squares.begin(), squares.end(), there);
                if (found == squares.end() || *found != there) continue;
                const auto other = static_cast<std::size_t>(found - squares.begin());
                const double longer = length + (x && y ? std::sqrt(2.0) : 1.0);
                if (longer < lengths[other]) next.emplace(lengths[other] = longer, other);
            }
        }
    }
    return 0;
}
