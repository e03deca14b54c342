// The picture about each corner of a face, and what is printed there, drawn as the camera sees it.
//
// The drawing is on a lattice of half pixels, so that its derivatives are those of the picture.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "image/picture.hpp"
#include "registration/blur.hpp"
#include "registration/planar_fit.hpp"

namespace trigpoint {

constexpr int LEAST_HALF_PX = 3, MOST_HALF_PX = 6;
constexpr int LATTICE = 2;                  // points a pixel
constexpr int SIDE = 2 * MOST_HALF_PX + 1;  // of a patch, pixels
constexpr int WIDTH = 16;                   // of its rows in memory

// A face as it is printed, so many texels a square; the face point (x, y) lies at texel
// (x, y) · scale + offset. `cells`: each texel with those right of it, below it, and below right, a
// byte each, so that one access has all that lie around a place.
struct Print {
    std::vector<std::uint32_t> cells;
    int height, width;
    double scale;
    Eigen::Vector2d offset;

    Print(const Grey& texels, double scale, const Eigen::Vector2d& offset);

    // From face points to texels, as a homography.
    Eigen::Matrix3d from_face() const;
};

// The value between the four texels of a cell of a print, 0 to 255, `across` and `down` of it.
inline __attribute__((always_inline)) float between(std::uint32_t four, float across, float down) {
    const auto texel = [four](int shift) {
        return static_cast<float>(static_cast<std::int32_t>(four >> shift & 255));
    };
    const float above = texel(0) + across * (texel(8) - texel(0));
    const float below = texel(16) + across * (texel(24) - texel(16));
    return above + down * (below - above);
}

// What a face has around its corners. `points`: in the face frame; `outward`: signs of the axes'
// directions of a sector that may be printed or not (Kalibr has squares there), 0 without one;
// `reach`: how far from a corner along both axes is looked at, metres; `square`: of a square,
// metres; `prints`: the finer the later; `is_balanced`: whether dark and light lie alike around
// every corner. Where they do not, ink that runs looks like corners that lie elsewhere.
struct CornerPattern {
    Points points, outward;
    double reach = 0, square = 1;
    std::vector<Print> prints;
    bool is_balanced = true;

    // The print whose texels are about a pixel where a square takes so many.
    const Print& print_for(double square_px) const;
};

// A part of a picture that begins at (left, top).
struct PartOfPicture {
    Grey grey;
    std::int64_t left = 0, top = 0;
};

// Of each pixel of a patch, what explains it: the derivative by the corner's place, the drawing's
// value, even light and how that rises along x and along y; what each number of the blur changes;
// what is seen, from middle grey.
enum Row { BY_X, BY_Y, VALUE, ONE, RISE_X, RISE_Y, XX, YY, XY, BUMP, SEEN, ROWS };
constexpr int OWN = XX, SHARED = SEEN - XX;  // numbers of a corner, and of the face's blur

// `rows`: for all pixels, 0 where one does not count; `count`: of its pixels in memory; `total`:
// how many show what is known.
struct Patch {
    int count;
    double total;
    alignas(32) std::array<std::array<float, SIDE * WIDTH>, ROWS> rows;
};

// Draws patches about corners that lie about where a fit has them.
class Drawer {
public:
    // `ids`: of the pattern's corners.
    Drawer(const PartOfPicture& part, const CornerPattern& pattern, const PlanarFit& fit,
           const std::vector<int>& ids, const Blur& blur);

    // The patch of the i-th corner about the whole pixel `nearest`, the pattern moved from where
    // the fit has it so that the corner lies at `pixel`; `is_light_even`: without a rise of the
    // light.
    void draw(std::size_t i, const Eigen::Vector2d& pixel, const Eigen::Vector2d& nearest,
              bool is_light_even, Patch& patch) const;

private:
    struct Quadratic;

    const PartOfPicture& part_;
    const CornerPattern& pattern_;
    const std::vector<int>& ids_;
    std::vector<Eigen::Vector2d> places_;
    const Print* print_;
    Unprojection texel_from_pixel_;
    Kernel kernel_;
    float response_;
    int half_;
};

}  // namespace trigpoint
