// The values (n,) of a grey picture (h, w) at pixels (n, 2); of what is no number, none.
#include "image/picture.hpp"

using namespace trigpoint;

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
