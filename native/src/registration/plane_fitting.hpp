// Fits planes and lenses to the corners of a face. A weak prior towards no lens, and towards one in
// the picture's middle, keeps noise from looking like one.
#pragma once

#include <optional>
#include <vector>

#include "registration/planar_fit.hpp"

namespace trigpoint {

// The fit to face points and pixels, (n, 2) each; none where they fix no plane. `start`: a fit of
// the same picture to begin with, and to take the lens from where `has_lens` is false; it is of the
// picture's size alone where `has_start` is false.
std::optional<PlanarFit> fit_plane(const PointsIn& points, const PointsIn& pixels,
                                   const PlanarFit& start, bool has_start, bool has_lens);

// Like fit_plane; lens and bend stay those of `start`, or none, where all points come within
// `enough_px` so: the search for a better one is long where a face hardly shows it.
std::optional<PlanarFit> settled_fit(const PointsIn& points, const PointsIn& pixels,
                                     const PlanarFit& start, bool has_start, double enough_px);

struct Scatter {
    double squares = 0;
    int freedom = 0;
};

// How far pixels of face points scatter: the sum of squares, pixel², of what no homography and no
// lens near the fit explains of them, and its freedom; none for n < 6. The lens counts as free also
// where the fit left it alone: else what it leaves over would look like corners that are off. To
// first order, by what is orthogonal to the fit's derivatives.
Scatter scatter_about(const PlanarFit& fit, const PointsIn& points, const PointsIn& pixels);

// What is never called wild: pixels, and share of the spacing, one for each corner.
struct SoundLimits {
    double least_px = 0.7;
    std::vector<double> least_share;
    double enough_px = -1;  // of settled_fit; below 0: the least that is never called wild
};

// Which corners lie where a flat face has them (`keep`, for each whether), and the fit to those.
// Drops the worst beyond some sigmas of the others' spread, again and again; no corner is sound
// where fewer than four remain or all scatter.
std::optional<PlanarFit> sound_corners(const PointsIn& points, const PointsIn& pixels,
                                       const PlanarFit& start, bool has_start,
                                       const SoundLimits& limits, std::vector<char>& keep);

}  // namespace trigpoint
