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

// The values at `count` places (x, y), MOST at most, as `Picture::at`; for loops that are compiled
// for wider registers. The picture has two rows and columns or more, and less than 2³¹ pixels.
template <int MOST, class T>
inline __attribute__((always_inline)) void sample_at_once(const Picture<T>& picture,
                                                          const float* __restrict xs,
                                                          const float* __restrict ys, int count,
                                                          float* __restrict values) {
    const auto width = static_cast<std::int32_t>(picture.width),
               height = static_cast<std::int32_t>(picture.height);
    const auto right = static_cast<float>(width - 1), bottom = static_cast<float>(height - 1);
    std::int32_t corner[MOST];
    float across[MOST], down[MOST];
    for (int k = 0; k < count; ++k) {
        float x = xs[k] > 0 ? xs[k] : 0, y = ys[k] > 0 ? ys[k] : 0;
        x = x < right ? x : right, y = y < bottom ? y : bottom;
        auto left = static_cast<std::int32_t>(x), top = static_cast<std::int32_t>(y);
        left = left < width - 2 ? left : width - 2, top = top < height - 2 ? top : height - 2;
        across[k] = x - static_cast<float>(left), down[k] = y - static_cast<float>(top);
        corner[k] = top * width + left;
    }
    for (int k = 0; k < count; ++k) {
        const T *above = picture.data + corner[k], *below = above + width;
        const auto first = static_cast<float>(above[0]), second = static_cast<float>(below[0]);
        const float upper = first + across[k] * (static_cast<float>(above[1]) - first),
                    lower = second + across[k] * (static_cast<float>(below[1]) - second);
        values[k] = upper + down[k] * (lower - upper);
    }
}

// The values of a picture of two rows and columns or more at many places (x, y), as `Picture::at`;
// all of these are numbers.
void sample(const Grey& grey, const float* x, const float* y, int count, float* values);

}  // namespace trigpoint
