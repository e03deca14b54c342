// What Python asks of a face that moves: how its homography changed from picture to picture.
#include <array>
#include <stdexcept>

#include "border.hpp"
#include "registration/plane_fitting.hpp"

using namespace trigpoint;

namespace {

// Where the points of a face lie, by a fit of the lens and bend of another; none where there is
// none.
std::optional<PlanarFit> with_lens_of(const PlanarFit& other, const PlanarFit& own,
                                      const PointsIn& points) {
    if (other.bend.degree == 0 && own.bend.degree == 0 && other.radial == own.radial &&
        other.aside == own.aside)
        return own;
    Points pixels(points.rows(), 2);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        pixels.row(i) = own.project(points.row(i)).transpose();
    return fit_plane(points, pixels, other, true, false);
}

}  // namespace

// (fit, last fit, expected fit, points of the face (k, 2), corners (n,), pixels (n, 2), change: of
// the homography, row by row, and the usual distance from what was expected, pixels (10)): 1 where
// the last fit has a like with the lens of this one.
TRIGPOINT_KERNEL(tp_moved) {
    const auto fit_in = [&](int i) { return PlanarFit::unpacked(arguments[i].array.as<double>()); };
    const PlanarFit fit = fit_in(0), expected = fit_in(2);
    const auto points = arguments[3].array.rows<2>();
    const auto before = with_lens_of(fit, fit_in(1), points);
    const Array& corners = arguments[4].array;
    if (!before || corners.shape[0] == 0) return 0;
    const auto pixels = arguments[5].array.rows<2>();
    std::vector<double> off;
    for (Eigen::Index i = 0; i < corners.shape[0]; ++i) {
        const std::int64_t corner = corners.as<const std::int64_t>()[i];
        if (!(corner >= 0 && corner < points.rows()))
            throw std::invalid_argument("a corner is none of the face's");
        off.push_back(expected.residual(points.row(corner), pixels.row(i)));
    }
    std::array<double, PlanarFit::NUMBERS> now, then;
    fit.pack(now.data()), before->pack(then.data());
    auto change = arguments[6].array.rows<1>();
    for (int i = 0; i < 9; ++i) change(i) = now[i] - then[i];
    change(9) = median(off);
    return 1;
}
