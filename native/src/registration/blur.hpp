// How a picture shows the edges of a print: softened or sharpened, lighter or darker than drawn.
#pragma once

#include <Eigen/Core>
#include <array>

namespace trigpoint {

// Bounds of the variances, pixel²: below 0 the camera sharpens, as most webcams do; the upper one
// is that of 6 pixels of motion. Where sharpening cannot be told from corners that lie elsewhere: a
// little less than a pixel's own.
constexpr double LEAST_VARIANCE = -1.5, LEAST_SOFT_VARIANCE = 0.12, MOST_VARIANCE = 3.0;
// Of a kernel, lattice steps.
constexpr int LEAST_RADIUS = 2, MOST_RADIUS = 6;

// A blur's kernel on a lattice: a sum of `terms` products of a row and a column, each of
// 2 radius + 1 shares, the same on both sides of their middle for the first `even` of them, and of
// the other sign for the others.
struct Kernel {
    using Taps = std::array<float, 2 * MOST_RADIUS + 1>;

    int radius, terms, even;
    std::array<Taps, 2 * MOST_RADIUS + 2> across, down;
};

// `variances`: xx, yy and covariance xy of the point spread, pixel², below 0 where the camera
// sharpens. `response`: how much faster grey values rise in the dark than in the light, as they do
// where light clips or ink runs; a value v of 0 to 1 is seen as v + response · v (1 - v).
struct Blur {
    Eigen::Vector3d variances{0.35, 0.35, 0.0};  // of a sharp lens and of the pixel's own width
    double response = 0;

    // The blur after a change of the variances and the response, within the bounds.
    Blur changed(const Eigen::Vector4d& change, double least) const;
    // The blur of a picture that is softened further, the same in all directions; pixel².
    Blur softened(double variance) const;
    // What softens so on a lattice of `step` points a pixel: a Gaussian along each principal axis;
    // what is narrower than the lattice shows is taken away by its second derivative (the heat
    // equation), which leaves the halos of a sharpened picture.
    Kernel kernel(int step) const;
};

}  // namespace trigpoint
