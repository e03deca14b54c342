// What quadrilaterals show where a marker has its cells.
#include "markers/quads.hpp"

using namespace trigpoint;

namespace {

// The homography from the unit square (0, 0), (1, 0), (1, 1), (0, 1) to a quad, in closed form:
// Heckbert, «Fundamentals of texture mapping and image warping» (1989), 2.2.3. A point on the
// horizon comes out far away, never as no number.
class FromSquare {
public:
    explicit FromSquare(const Quad& quad) {
        const Eigen::Vector2d bend = quad[0] - quad[1] + quad[2] - quad[3],
                              right = quad[1] - quad[2], down = quad[3] - quad[2];
        const double determinant = right.x() * down.y() - right.y() * down.x();
        const double safe = std::abs(determinant) > TINY ? determinant : TINY;
        const double g = (bend.x() * down.y() - bend.y() * down.x()) / safe,
                     h = (right.x() * bend.y() - right.y() * bend.x()) / safe;
        map_.col(0) << quad[1] - quad[0] + g * quad[1], g;
        map_.col(1) << quad[3] - quad[0] + h * quad[3], h;
        map_.col(2) << quad[0], 1;
    }

    Eigen::Vector2d operator()(const Eigen::Vector2d& place) const {
        const Eigen::Vector3d flat = map_.leftCols<2>() * place + map_.col(2);
        return flat.head<2>() / (std::abs(flat.z()) < TINY ? TINY : flat.z());
    }

private:
    static constexpr double TINY = 1e-9;
    Eigen::Matrix3d map_;
};

}  // namespace

// (grey (h, w), quads (n, 8), places (c, 2) in the unit square, least contrast, cells (n, c)): the
// values at these places of each quad, their mean taken away and of length 1; 0 where their
// standard deviation is no more than that. How many quads have more.
TRIGPOINT_KERNEL(tp_cells) {
    const Grey grey = Grey::of(arguments[0].array);
    const auto quads = arguments[1].array.rows<8>();
    const auto places = arguments[2].array.rows<2>();
    const double least = arguments[3].number;
    const auto count = static_cast<std::size_t>(places.rows());
    std::vector<float> xs(count), ys(count), values(count);
    std::int64_t seen = 0;
    for (Eigen::Index i = 0; i < quads.rows(); ++i) {
        Eigen::Map<Eigen::VectorXd> cells(arguments[4].array.as<double>() + i * places.rows(),
                                          places.rows());
        cells.setZero();
        if (grey.height < 2 || grey.width < 2 || places.rows() == 0) continue;
        Quad quad;
        for (int k = 0; k < 4; ++k) quad[k] = quads.row(i).segment<2>(2 * k);
        const FromSquare pixel_of(quad);
        bool is_known = true;
        for (Eigen::Index k = 0; k < places.rows() && is_known; ++k) {
            const Eigen::Vector2f pixel = pixel_of(places.row(k).transpose()).cast<float>();
            is_known = pixel.allFinite();
            xs[k] = pixel.x(), ys[k] = pixel.y();
        }
        if (!is_known) continue;
        sample(grey, xs.data(), ys.data(), static_cast<int>(places.rows()), values.data());
        for (Eigen::Index k = 0; k < places.rows(); ++k) cells(k) = values[k];
        cells.array() -= cells.mean();
        const double length = cells.norm();
        if (length > least * std::sqrt(static_cast<double>(places.rows()))) {
            cells /= length;
            ++seen;
        } else {
            cells.setZero();
        }
    }
    return seen;
}
