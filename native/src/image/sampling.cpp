// Values of pictures between their pixels.
#include "image/picture.hpp"

using namespace trigpoint;

namespace {

constexpr int AT_ONCE = 64;

TRIGPOINT_WIDE
void sample_some(const Grey& grey, const float* xs, const float* ys, int count, float* values) {
    sample_at_once<AT_ONCE>(grey, xs, ys, count, values);
}

}  // namespace

void trigpoint::sample(const Grey& grey, const float* x, const float* y, int count, float* values) {
    for (int k = 0; k < count; k += AT_ONCE)
        sample_some(grey, x + k, y + k, std::min(AT_ONCE, count - k), values + k);
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
