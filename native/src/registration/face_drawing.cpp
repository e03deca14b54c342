// A face as a picture should show it, drawn small, to be held against the picture.
#include <stdexcept>
#include <utility>
#include <vector>

#include "border.hpp"
#include "registration/patches.hpp"

namespace trigpoint {
namespace {

// The value at a place of a print, 0 to 255, interpolated; beyond its edge as at the edge, and of
// what is no number as at its first.
float value_at(const Print& print, const Eigen::Vector2f& place) {
    const auto within = [](float at, int length) {
        const float most = static_cast<float>(length - 1);
        return at > 0 ? (at < most ? at : most) : 0.0F;
    };
    const float x = within(place.x(), print.width), y = within(place.y(), print.height);
    const int column = static_cast<int>(x), row = static_cast<int>(y);
    return between(print.cells[static_cast<std::size_t>(row) * print.width + column],
                   x - static_cast<float>(column), y - static_cast<float>(row));
}

}  // namespace
}  // namespace trigpoint

using namespace trigpoint;

// (pattern, fit, first (2,): the pixel in whose corner the drawing begins, pixels a cell, cells a
// square, outline (4, 2) of the face, drawn (h, w)): each cell is the mean of 2 x 2 places, and
// what is outside of the outline has the mean brightness of the inside.
TRIGPOINT_KERNEL(tp_face_drawn) {
    const auto& pattern = *static_cast<const CornerPattern*>(arguments[0].object);
    if (pattern.prints.empty()) throw std::invalid_argument("the pattern has no print");
    const PlanarFit fit = PlanarFit::unpacked(arguments[1].array.as<double>());
    const Eigen::Vector2d first = arguments[2].array.rows<1>().array() - 0.5;
    const double cell = arguments[3].number;
    const Print& print = pattern.print_for(2 * arguments[4].number);
    const auto outline = arguments[5].array.rows<2>();
    const Eigen::Vector2f low =
        (outline.colwise().minCoeff().transpose() * print.scale + print.offset).cast<float>();
    const Eigen::Vector2f high =
        (outline.colwise().maxCoeff().transpose() * print.scale + print.offset).cast<float>();
    auto* drawn = arguments[6].array.as<float>();
    const std::int64_t height = arguments[6].array.shape[0], width = arguments[6].array.shape[1];

    const Unprojection place_of(fit, print.from_face());
    // The places of cells' corners, a row and the next: within a cell they are as good as even.
    std::vector<Eigen::Vector2f> above(static_cast<std::size_t>(width + 1)), below = above;
    const auto take_row = [&](std::int64_t y, std::vector<Eigen::Vector2f>& row) {
        for (std::int64_t x = 0; x <= width; ++x)
            row[static_cast<std::size_t>(x)] =
                place_of(first + cell * Eigen::Vector2d(double(x), double(y))).cast<float>();
    };
    take_row(0, below);
    std::vector<char> is_outside(static_cast<std::size_t>(height * width));
    double sum = 0;
    std::int64_t inside = 0;
    for (std::int64_t y = 0; y < height; ++y) {
        std::swap(above, below);
        take_row(y + 1, below);
        for (std::int64_t x = 0; x < width; ++x) {
            const auto i = static_cast<std::size_t>(x);
            const Eigen::Vector2f middle =
                (above[i] + above[i + 1] + below[i] + below[i + 1]) * 0.25F;
            const Eigen::Vector2f right =
                (above[i + 1] + below[i + 1] - above[i] - below[i]) * 0.125F;
            const Eigen::Vector2f down =
                (below[i] + below[i + 1] - above[i] - above[i + 1]) * 0.125F;
            const auto at = static_cast<std::size_t>(y * width + x);
            is_outside[at] =
                !((middle.array() >= low.array()).all() && (middle.array() <= high.array()).all());
            if (is_outside[at]) continue;
            drawn[at] =
                0.25F *
                (value_at(print, middle - right - down) + value_at(print, middle + right - down) +
                 value_at(print, middle - right + down) + value_at(print, middle + right + down));
            sum += drawn[at], ++inside;
        }
    }
    const float mean = inside > 0 ? static_cast<float>(sum / static_cast<double>(inside)) : 0.0F;
    for (std::size_t at = 0; at < is_outside.size(); ++at)
        if (is_outside[at]) drawn[at] = mean;
    return inside;
}
