// Makes a grid of corners whole: drops the wild ones, and looks where the next ones should be.
//
// Every corner is judged by those about it, and every free place is predicted from them, so that no
// lens and no paper is too bent: over two squares each is nearly a parallelogram.
#pragma once

#include "boards/grid.hpp"
#include "boards/saddles.hpp"

namespace trigpoint {

// The grid without corners that do not lie where their neighbours have them; those that nothing can
// be said about stay.
Grid cleaned(Grid grid);

// The grid with every corner that its own predict and the picture shows. Stops at the pattern's
// edge, where no X corner is; `longest`: the longest side of any pattern that is looked for.
Grid grown(Grid grid, const Curvature& curvature, int longest);

}  // namespace trigpoint
