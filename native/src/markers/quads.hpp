// Dark quadrilaterals, which markers are, whatever dictionary they are from.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "image/picture.hpp"

namespace trigpoint {

// Four corners, clockwise in a picture from any of them, pixels.
using Quad = std::array<Eigen::Vector2d, 4>;

// Thresholds a picture and looks at the outlines of dark pieces; its memory is kept for the next.
class QuadSearch {
public:
    // The quadrilaterals of a picture of at least such a perimeter, darker than their surroundings
    // of `window` (odd) pixels; none where the picture is too crowded. `parts_touching`: pieces
    // that touch with their corners are parted, by a pixel of light.
    const std::vector<Quad>& find(const Grey& grey, int window, double least_perimeter,
                                  bool parts_touching);
    // A picture `step` times smaller, each pixel the mean of step × step.
    Grey shrunk(const Grey& grey, std::int64_t step);

private:
    // A dark run of a row: from `begin` to `end`, that not; `piece`: what it belongs to, and until
    // all are found a run of that.
    struct Run {
        std::int32_t begin, end, row, piece;
    };
    struct Point {
        std::int32_t x, y;
    };
    struct Points {
        std::vector<std::int32_t> x, y;

        void resize(std::size_t count) { x.resize(count), y.resize(count); }
        void put(std::size_t i, Point point) { x[i] = point.x, y[i] = point.y; }
    };
    // A dark piece: its first pixel, and its ends.
    struct Piece {
        Point first;
        std::int32_t left, top, right, bottom;
    };

    Grey parted(const Grey& grey);
    void threshold(const Grey& grey, int window);
    bool find_runs();
    void join_runs();
    std::int32_t root(std::int32_t run);
    // The outline of a piece, clockwise; whether it closes within `most` points.
    bool trace(const Piece& piece, std::size_t most);
    // Whether pixels of a row are dark, 1 or 0; about the picture lies one more that is not.
    std::uint8_t* dark(std::int64_t y) { return dark_.data() + (y + 1) * (width_ + 2) + 1; }
    void add_quad_of_outline();

    std::int64_t width_ = 0, height_ = 0;
    std::vector<std::uint8_t> shrunk_, parted_, dark_;
    std::vector<std::uint16_t> columns_;
    std::vector<Run> runs_;
    std::vector<std::int32_t> changes_, off_;
    std::vector<Piece> pieces_;
    Points outline_;
    std::vector<std::size_t> kept_;
    std::vector<Quad> quads_;
};

// The quads between straight lines along their edges in the picture. An outline rounds the corners
// off, by two pixels where a slanted marker is pointed; its sides it meets. Where lines lead far
// from a corner it is left as it is.
Quad straightened(const Grey& grey, const Quad& quad);

}  // namespace trigpoint
