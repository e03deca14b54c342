// Measures corners by laying the printed pattern over the picture.
//
// Around each corner the pattern is drawn as the camera must see it: through the face's planar fit,
// so in its perspective and lens, and blurred as the picture is. What is left between drawing and
// picture says how far the corner is off. Next squares and markers are in the drawing, so they pull
// at nothing, and blur widens both alike.
#pragma once

#include <optional>
#include <vector>

#include "registration/alignment.hpp"
#include "registration/plane_fitting.hpp"

namespace trigpoint {

// Where corners are. `is_clear`: whether the picture shows the corner as the pattern has it,
// `is_whole`: with nothing before any of it; `sigma`: of a coordinate by the picture's noise,
// pixels; `blur`: of the picture there; `fit`: the last one used.
struct Registration {
    std::vector<Eigen::Vector2d> pixels;
    std::vector<char> is_clear, is_whole;
    std::vector<double> sigma;
    Blur blur;
    PlanarFit fit;
};

// The corners `ids` of a face that lies about where `fit` has it: to a pixel or so, or to two or
// three where `is_rough` (then it is brought near by a wider drawing of a few corners). `starts`:
// where corners were found already, to a pixel or so, no number where not. While corners are far,
// the light counts as even.
Registration registered(const Grey& grey, const CornerPattern& pattern, const PlanarFit& fit,
                        const std::vector<int>& ids, const std::vector<Eigen::Vector2d>& starts,
                        const Blur& blur, bool is_rough);

// Corners of one face: ids, rising, and pixels; `sigma`: of a coordinate; `blur`: of the picture
// there; `fit`: the plane through them.
struct Measured {
    std::vector<int> corners;
    std::vector<Eigen::Vector2d> pixels;
    double sigma = 0;
    Blur blur;
    PlanarFit fit;
};

// Every corner that the picture shows of a face that lies about where `fit` has it. `starts`: for
// every corner of the face, or none at all. None where the picture shows none, or those that it
// shows lie on no plane.
std::optional<Measured> measured(const Grey& grey, const CornerPattern& pattern,
                                 const PlanarFit& fit, const std::vector<Eigen::Vector2d>& starts,
                                 const Blur& blur, bool is_rough);

// Where the gradients about a pixel meet (Förstner and Gülch 1987), by steps from there.
Eigen::Vector2d where_gradients_meet(const Grey& grey, const Eigen::Vector2d& start);

}  // namespace trigpoint
