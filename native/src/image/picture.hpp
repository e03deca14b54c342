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
        x = std::clamp(x, 0.0F, static_cast<float>(width - 1));
        y = std::clamp(y, 0.0F, static_cast<float>(height - 1));
        const auto left =
            std::min(static_cast<std::int64_t>(x), std::max<std::int64_t>(width - 2, 0));
        const auto top =
            std::min(static_cast<std::int64_t>(y), std::max<std::int64_t>(height - 2, 0));
        const auto right = std::min(left + 1, width - 1), below = std::min(top + 1, height - 1);
        const float across = x - static_cast<float>(left), down = y - static_cast<float>(top);
        const T *upper = row(top), *lower = row(below);
        const float above = upper[left] + across * (upper[right] - upper[left]);
        const float under = lower[left] + across * (lower[right] - lower[left]);
        return above + down * (under - above);
    }
};

using Grey = Picture<std::uint8_t>;

}  // namespace trigpoint
