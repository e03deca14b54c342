// What quadrilaterals show where a marker has its cells.
#include "markers/cells.hpp"

#include <stdexcept>

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

CellReader::CellReader(const Grey& grey, const PointsIn& places, double least)
    : grey_(grey), places_(places), least_(least * std::sqrt(static_cast<double>(places.rows()))) {
    const auto count = static_cast<std::size_t>(places.rows());
    xs_.resize(count), ys_.resize(count), values_.resize(count);
}

bool CellReader::read(const Quad& quad, Eigen::Ref<Eigen::VectorXd> cells) {
    cells.setZero();
    if (grey_.height < 2 || grey_.width < 2 || places_.rows() == 0 || !locate(quad)) return false;
    sample(grey_, xs_.data(), ys_.data(), static_cast<int>(places_.rows()), values_.data());
    for (Eigen::Index k = 0; k < places_.rows(); ++k) cells(k) = values_[k];
    cells.array() -= cells.mean();
    const double length = cells.norm();
    if (!(length > least_)) return cells.setZero(), false;
    cells /= length;
    return true;
}

// Where a quad has the places in the picture; false where that is nowhere.
bool CellReader::locate(const Quad& quad) {
    const FromSquare pixel_of(quad);
    for (Eigen::Index k = 0; k < places_.rows(); ++k) {
        const Eigen::Vector2f pixel = pixel_of(places_.row(k).transpose()).cast<float>();
        if (!pixel.allFinite()) return false;
        xs_[k] = pixel.x(), ys_[k] = pixel.y();
    }
    return true;
}

// (grey (h, w), quads (n, 8), places (c, 2) in the unit square, least contrast, cells (n, c)): the
// values at these places of each quad, their mean taken away and of length 1; 0 where their
// standard deviation is no more than that. How many quads have more.
TRIGPOINT_KERNEL(tp_cells) {
    const auto quads = arguments[1].array.rows<8>();
    const auto places = arguments[2].array.rows<2>();
    CellReader reader(Grey::of(arguments[0].array), places, arguments[3].number);
    std::int64_t seen = 0;
    for (Eigen::Index i = 0; i < quads.rows(); ++i) {
        Eigen::Map<Eigen::VectorXd> cells(arguments[4].array.as<double>() + i * places.rows(),
                                          places.rows());
        seen += reader.read(quad_of(quads.row(i)), cells);
    }
    return seen;
}

// (grey (h, w), upright quads (n, 8), places (c, 2), least contrast, templates (c, t), which of
// these each quad should show (n,), scores (n,)): the correlations; 0 without that contrast. How
// many quads have more.
TRIGPOINT_KERNEL(tp_marker_agreement) {
    const auto quads = arguments[1].array.rows<8>();
    const auto places = arguments[2].array.rows<2>();
    const Array& given = arguments[4].array;
    const Eigen::Map<const Templates> templates(given.as<double>(), given.shape[0], given.shape[1]);
    const auto* which = arguments[5].array.as<const std::int64_t>();
    CellReader reader(Grey::of(arguments[0].array), places, arguments[3].number);
    Eigen::VectorXd cells(places.rows());
    std::int64_t seen = 0;
    for (Eigen::Index i = 0; i < quads.rows(); ++i) {
        if (!(which[i] >= 0 && which[i] < templates.cols()))
            throw std::invalid_argument("there is no marker of that number");
        seen += reader.read(quad_of(quads.row(i)), cells);
        arguments[6].array.as<double>()[i] = templates.col(which[i]).dot(cells);
    }
    return seen;
}
