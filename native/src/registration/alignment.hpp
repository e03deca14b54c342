// How far corners are off: Gauss-Newton between patches of a picture and the drawing of them.
//
// Lucas and Kanade (1981); contrast, brightness and how that rises across are solved for each
// corner (uneven light would pull at it), the blur for the whole face. What does not look like the
// pattern is left out pixel by pixel, or corner by corner.
#pragma once

#include <optional>
#include <vector>

#include "registration/patches.hpp"

namespace trigpoint {

// What most corners of the face have: contrast, brightness and mean square of what is left.
struct Usual {
    double gain, level, power;
};

// The best match of a corner, by linear least squares. `total`, `count`: pixels that show what is
// known, and those of them that count; `variance`: the drawing's; `inverse`: of the normal
// equations of a corner's own numbers; `values`: these; `by_blur`: those that take up a change of
// blur; `left`: products of the blur's rows, and of what is seen, after that.
struct Match {
    double total, count, variance;
    Eigen::Matrix<double, OWN, OWN> inverse;
    Eigen::Matrix<double, OWN, 1> values;
    Eigen::Matrix<double, OWN, SHARED> by_blur;
    Eigen::Matrix<double, SHARED + 1, SHARED + 1> left;

    static Match of(const Patch& patch);
    double gain() const { return values(VALUE); }
    double power() const { return std::max(left(SHARED, SHARED), 0.0) / std::max(count, 1.0); }
};

// One step for every corner. `step`: from where the pattern was drawn to where it is, pixels;
// `is_clear`: whether the picture shows the corner; `is_whole`: whether all about it looks as
// printed; `sigma`: of a step's coordinate, by what is left; `blur`: the better one; `change`: by
// how much.
struct Alignment {
    struct Corner {
        Eigen::Vector2d step;
        bool is_clear, is_whole;
        double sigma;
    };
    std::vector<Corner> corners;
    Blur blur;
    Eigen::Vector4d change;
    Usual usual;

    // The length of most clear corners' steps, pixels; infinite where none is clear.
    double usual_length() const;
    bool has_clear() const;
};

// Where corners are looked for: their ids, pixels, and the whole pixels about which.
struct Corners {
    std::vector<int> ids;
    std::vector<Eigen::Vector2d> pixels, nearest;
};

// `longest_px`: no step is trusted beyond; `usual`: what most of the face's corners have, where
// these are only a few of them; `is_light_even`: better from far off, where light that rises would
// take up what the steps should. Where a pattern is not balanced, neither response nor sharpening
// can be told from steps, and neither is.
Alignment aligned(const PartOfPicture& part, const CornerPattern& pattern, const PlanarFit& fit,
                  const Corners& corners, const Blur& blur, double longest_px,
                  const std::optional<Usual>& usual, bool is_light_even);

}  // namespace trigpoint
