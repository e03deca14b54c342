// Pictures, and their values between pixels.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "border.hpp"

namespace trigpoint {

// A picture that somebody else owns, row by row; (0, 0) is the centre of the top-left pixel.
template <class T>
struct Picture {
    const T* data;
    std::int64_t height, width;

    static Picture of(const Array& array) {
        return {array.as<const T>(), array.shape[0], array.shape[1]};
    }

    const T* row(std::int64_t y) const { return data + y * width; }

    // The value at (x, y), interpolated; beyond the edge as at the edge. The picture is not empty.
    float at(float x, float y) const {
        x = std::min(std::max(x, 0.0F), static_cast<float>(width - 1));
        y = std::min(std::max(y, 0.0F), static_cast<float>(height - 1));
        const auto left = static_cast<std::int32_t>(x), top = static_cast<std::int32_t>(y);
        const std::int64_t right = left + 1 < width ? 1 : 0, below = top + 1 < height ? width : 0;
        const float across = x - static_cast<float>(left), down = y - static_cast<float>(top);
        const T* corner = data + top * width + left;
        const float above = corner[0] + across * (corner[right] - corner[0]);
        const float under = corner[below] + across * (corner[below + right] - corner[below]);
        return above + down * (under - above);
    }
};

using Grey = Picture<std::uint8_t>;

// The values of a picture of two rows and columns or more at many places (x, y), as `Picture::at`;
// all of these are numbers.
void sample(const Grey& grey, const float* x, const float* y, int count, float* values);

}  // namespace trigpoint
