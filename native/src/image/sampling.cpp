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
