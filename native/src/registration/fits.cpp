// What Python asks of fits: planes through corners, and where they put points.
#include <stdexcept>

#include "border.hpp"
#include "registration/plane_fitting.hpp"

using namespace trigpoint;

namespace {

PlanarFit fit_in(const Argument& argument) {
    return PlanarFit::unpacked(argument.array.as<double>());
}

}  // namespace

// (fit, points (n, 2), pixels (n, 2)): where a fit puts face points.
TRIGPOINT_KERNEL(tp_project) {
    const PlanarFit fit = fit_in(arguments[0]);
    const auto points = arguments[1].array.rows<2>();
    auto pixels = arguments[2].array.rows<2>();
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        pixels.row(i) = fit.project(points.row(i).transpose());
    return 0;
}

// (points (n, 2), pixels (n, 2), start, has start, has lens, fit): 1 where there is a fit.
TRIGPOINT_KERNEL(tp_fit_plane) {
    const auto fit =
        fit_plane(arguments[0].array.rows<2>(), arguments[1].array.rows<2>(), fit_in(arguments[2]),
                  arguments[3].whole != 0, arguments[4].whole != 0);
    if (fit) fit->pack(arguments[5].array.as<double>());
    return fit.has_value();
}

// (points (n, 2), pixels (n, 2), start, has start, enough, fit): 1 where there is a fit.
TRIGPOINT_KERNEL(tp_settled_fit) {
    const auto fit =
        settled_fit(arguments[0].array.rows<2>(), arguments[1].array.rows<2>(),
                    fit_in(arguments[2]), arguments[3].whole != 0, arguments[4].number);
    if (fit) fit->pack(arguments[5].array.as<double>());
    return fit.has_value();
}

// (fit, points (n, 2), pixels (n, 2), squares (1)): the freedom of the scatter.
TRIGPOINT_KERNEL(tp_scatter) {
    const Scatter scatter = scatter_about(fit_in(arguments[0]), arguments[1].array.rows<2>(),
                                          arguments[2].array.rows<2>());
    *arguments[3].array.as<double>() = scatter.squares;
    return scatter.freedom;
}

// (points (n, 2), pixels (n, 2), start, has start, least px, least share (n,), enough, keep (n,),
// fit): 1 where there is a fit.
TRIGPOINT_KERNEL(tp_sound_corners) {
    const auto share = arguments[5].array.rows<1>();
    SoundLimits limits;
    limits.least_px = arguments[4].number;
    limits.least_share.assign(share.data(), share.data() + share.size());
    limits.enough_px = arguments[6].number;
    std::vector<char> keep;
    const auto fit = sound_corners(arguments[0].array.rows<2>(), arguments[1].array.rows<2>(),
                                   fit_in(arguments[2]), arguments[3].whole != 0, limits, keep);
    auto kept = arguments[7].array.rows<1>();
    for (Eigen::Index i = 0; i < kept.size(); ++i) kept(i) = keep[static_cast<std::size_t>(i)];
    if (fit) fit->pack(arguments[8].array.as<double>());
    return fit.has_value();
}
