// How likely it is that a checkerboard is where a fit has it: one likelihood over its squares.
//
// Each square is as dark or as light against its neighbours as printed, or not. A board shows
// nearly all of them right, whatever else is there a third by chance. So the squares' odds add up
// to those of the board against clutter. The line of squares that a larger board would have beyond
// each side is weighed in the same way: it says whether the board ends there. And a board's corners
// lie as evenly as it is printed, while those of clutter, as where bars cross, may do so or not.
#pragma once

#include <array>
#include <vector>

#include "boards/placement.hpp"
#include "image/picture.hpp"

namespace trigpoint {

// `board`: log odds of the board against clutter, nats; `ends`: the same of its end against a board
// that goes on, top, bottom, left and right, 0 where the picture ends before that.
struct Evidence {
    double board = 0;
    std::array<double, 4> ends{};

    // Whether no doubt is left that it is there and is no part of a larger one.
    bool is_board() const;
};

// The evidence for a board where `fit` has it, from places, in squares from corner 0, to pixels.
// `ids`: the corners that are seen, at `pixels` (n, 2); squares with none of them are hidden, and
// say nothing.
Evidence weighed(const Grey& grey, const BoardShape& shape, const PlanarFit& fit,
                 const std::vector<int>& ids, const std::vector<Eigen::Vector2d>& pixels);

}  // namespace trigpoint
