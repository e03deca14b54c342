// What Python asks of a face that moves: how its homography changed from picture to picture.
#include <stdexcept>

#include "border.hpp"
#include "registration/plane_fitting.hpp"

using namespace trigpoint;

namespace {

// Rows `ids` (n,) of a face's points.
Points some_of(const PointsIn& points, const Array& ids) {
    const auto* which = ids.as<const std::int64_t>();
    Points some(ids.shape[0], 2);
    for (Eigen::Index i = 0; i < some.rows(); ++i) {
        if (!(which[i] >= 0 && which[i] < points.rows()))
            throw std::invalid_argument("a corner is none of the face's");
        some.row(i) = points.row(which[i]);
    }
    return some;
}

// Where the points of a face lie, by a fit of the lens and bend of another; none where there is
// none.
std::optional<PlanarFit> with_lens_of(const PlanarFit& other, const PlanarFit& own,
                                      const Points& points) {
    if (other.bend.degree == 0 && own.bend.degree == 0 && other.radial == own.radial &&
        other.aside == own.aside)
        return own;
    Points pixels(points.rows(), 2);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        pixels.row(i) = own.project(points.row(i)).transpose();
    return fit_plane(points, pixels, other, true, false);
}

}  // namespace

// (fit, last fit, expected fit, points of the face (k, 2), corners then (m,), corners (n,), pixels
// (n, 2), change: of the homography, row by row, and the usual distance from what was expected,
// pixels (10)): 1 where the last fit has a like with the lens of this one.
TRIGPOINT_KERNEL(tp_moved) {
    const auto fit_in = [&](int i) { return PlanarFit::unpacked(arguments[i].array.as<double>()); };
    const PlanarFit fit = fit_in(0), expected = fit_in(2);
    const auto points = arguments[3].array.rows<2>();
    const auto before = with_lens_of(fit, fit_in(1), some_of(points, arguments[4].array));
    const Points seen = some_of(points, arguments[5].array);
    if (!before || seen.rows() == 0) return 0;
    const auto pixels = arguments[6].array.rows<2>();
    std::vector<double> off;
    for (Eigen::Index i = 0; i < seen.rows(); ++i)
        off.push_back(expected.residual(seen.row(i), pixels.row(i)));
    auto change = arguments[7].array.rows<1>();
    for (int i = 0; i < 9; ++i)
        change(i) = fit.homography(i / 3, i % 3) - before->homography(i / 3, i % 3);
    change(9) = median(off);
    return 1;
}
