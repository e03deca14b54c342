// Values of pictures between their pixels.
#include "image/picture.hpp"

using namespace trigpoint;

namespace {

constexpr int AT_ONCE = 64;

TRIGPOINT_WIDE
void sample_some(const std::uint8_t* __restrict data, std::int32_t width, std::int32_t height,
                 const float* __restrict xs, const float* __restrict ys, int count,
                 float* __restrict values) {
    const auto right = static_cast<float>(width - 1), bottom = static_cast<float>(height - 1);
    std::int32_t corner[AT_ONCE];
    float across[AT_ONCE], down[AT_ONCE];
    for (int k = 0; k < count; ++k) {
        float x = xs[k] > 0 ? xs[k] : 0, y = ys[k] > 0 ? ys[k] : 0;
        x = x < right ? x : right, y = y < bottom ? y : bottom;
        auto left = static_cast<std::int32_t>(x), top = static_cast<std::int32_t>(y);
        left = left < width - 2 ? left : width - 2, top = top < height - 2 ? top : height - 2;
        across[k] = x - static_cast<float>(left), down[k] = y - static_cast<float>(top);
        corner[k] = top * width + left;
    }
    for (int k = 0; k < count; ++k) {
        const std::uint8_t *above = data + corner[k], *below = above + width;
        const auto first = static_cast<float>(above[0]), second = static_cast<float>(below[0]);
        const float upper = first + across[k] * (static_cast<float>(above[1]) - first),
                    lower = second + across[k] * (static_cast<float>(below[1]) - second);
        values[k] = upper + down[k] * (lower - upper);
    }
}

}  // namespace

void trigpoint::sample(const Grey& grey, const float* x, const float* y, int count, float* values) {
    for (int k = 0; k < count; k += AT_ONCE)
        sample_some(grey.data, static_cast<std::int32_t>(grey.width),
                    static_cast<std::int32_t>(grey.height), x + k, y + k,
                    std::min(AT_ONCE, count - k), values + k);
}

// The values (n,) of a grey picture (h, w) at pixels (n, 2); of what is no number, none.
TRIGPOINT_KERNEL(tp_sampled) {
    const Grey grey = Grey::of(arguments[0].array);
    const auto pixels = arguments[1].array.rows<2>();
    auto values = arguments[2].array.rows<1>();
    for (Eigen::Index i = 0; i < pixels.rows(); ++i) {
        const bool is_known = pixels.row(i).allFinite() && grey.height > 0 && grey.width > 0;
        values(i) = is_known ? grey.at(float(pixels(i, 0)), float(pixels(i, 1))) : std::nan("");
    }
    return 0;
}
