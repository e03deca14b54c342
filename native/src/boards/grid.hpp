// Joins X corners into the grids that they form, each with whole-number coordinates.
//
// Two corners are neighbours where the edges that leave them meet: each lies in the direction of
// one of the other's edges, with light and dark on the same sides, and is the nearest such. Links
// that both ends choose make a graph; walking it gives every corner its place. Bounded work, no
// search that fails slowly.
#pragma once

#include <vector>

#include "boards/saddles.hpp"

namespace trigpoint {

// Fewer corners are chance: three by three predict those beside them both ways.
constexpr std::size_t LEAST_CORNERS = 9;

// A corner of a grid. Its place: x × y points into the picture (never mirrored); `is_dark`: whether
// the square towards (-x, -y) is dark.
struct GridCorner {
    int x, y;
    Place pixel;
    bool is_dark;
};

using Grid = std::vector<GridCorner>;

// The ends of a grid's places.
struct Extent {
    int left, top, right, bottom;

    static Extent of(const Grid& grid);
    int width() const { return right - left + 1; }
    int height() const { return bottom - top + 1; }
};

// All grids of enough corners, the largest first.
std::vector<Grid> find_grids(const std::vector<Saddle>& saddles);

}  // namespace trigpoint
