// Where on a grid of corners a board lies: which of the grid's corners are which of the board's.
//
// A grid may have chance corners beside a board, run on over a second one, or lack lines that are
// hidden or outside the picture. So every place of the board on it is weighed: by the corners that
// would then be seen, by those that would be missing though they are in view, and by those beside
// the board that should not be there.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "boards/grid.hpp"
#include "registration/planar_fit.hpp"

namespace trigpoint {

// What a board's corners say of it: how many there are each way; `is_inverted`: whether the square
// at the top left is light.
struct BoardShape {
    int columns, rows;
    bool is_inverted;

    int count() const { return columns * rows; }
};

// A board on a grid: the id of each of the grid's corners, -1 of those beside the board; `score`:
// corners for it less those against it.
struct Placement {
    std::vector<int> ids;
    int score;
};

// From a grid's places to the picture's pixels; none where the corners lie on no plane.
using FitOfPlaces = std::function<std::optional<PlanarFit>()>;

// The best place of a board on a grid; none where it shows too little of it, or leaves open where
// the board lies. `least_share`: how many of its corners must be seen; `fit_of`: asked where
// corners are missing that may lie outside of the picture, which is (width, height).
std::optional<Placement> placed(const Grid& grid, const BoardShape& shape, double width,
                                double height, double least_share, const FitOfPlaces& fit_of);

}  // namespace trigpoint
