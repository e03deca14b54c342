// What a picture shows on a board's own grid, against what its file has there.
#include <algorithm>
#include <stdexcept>

#include "markers/cells.hpp"
#include "registration/planar_fit.hpp"

using namespace trigpoint;

namespace {

// How far a quadrilateral's corners may lie from where a marker's would be, of its side: half of
// what a chessboard square is larger than its marker.
constexpr double NEAR = 0.15;
// Correlation of a marker's code: surely this marker (one bit of 16 wrong); as well as not; and as
// well as it, since another one has 0, by chance a quarter.
constexpr double SURELY = 0.85, HARDLY = 0.25, PROBABLY = 0.5;

// Where a marker could be.
struct Place {
    Quad corners;
    Eigen::Vector2d middle;
    double side;
    std::int64_t marker;  // among all; below 0: the file has none there
    bool is_within, agrees = false, is_elsewhere = false, is_foreign = false;
};

// A quadrilateral there: how well it is the file's own marker, and the best of all.
struct Seen {
    std::size_t place;
    double own, best;
    bool is_any;
};

Eigen::Vector2d middle_of(const Quad& quad) { return (quad[0] + quad[1] + quad[2] + quad[3]) / 4; }

Quad quad_at(const Array& quads, std::int64_t row, int first = 0) {
    return quad_of(
        Eigen::Map<const Eigen::Matrix<double, 8, 1>>(quads.as<const double>() + 8 * row), first);
}

// How far corners lie from those of a place on the mean.
double off_by(const Quad& quad, const Place& place) {
    double off = 0;
    for (int k = 0; k < 4; ++k) off += (quad[k] - place.corners[k]).norm();
    return off / 4;
}

// The corner of a quadrilateral that is the first of a place's; -1 where it does not lie there.
int first_at(const Array& quads, std::int64_t row, const Place& place) {
    int best = 0;
    double nearest = off_by(quad_at(quads, row), place);
    for (int first = 1; first < 4; ++first) {
        const double off = off_by(quad_at(quads, row, first), place);
        if (off < nearest) nearest = off, best = first;
    }
    return nearest < NEAR * place.side ? best : -1;
}

// Whether any of the corners that are seen is near a place.
bool is_reached(const Array& reached, std::int64_t place, const Array& corners) {
    const auto* near = reached.as<const std::uint8_t>() + place * reached.shape[1];
    const auto* seen = corners.as<const std::int64_t>();
    return std::any_of(seen, seen + corners.shape[0], [&](std::int64_t id) {
        if (!(id >= 0 && id < reached.shape[1]))
            throw std::invalid_argument("a corner is none of the board's");
        return near[id] != 0;
    });
}

}  // namespace

// (grey (h, w), fit, corners (k,) that are seen, places (n, 8) of markers on the face, the file's
// marker there (n,) or below 0, whether that is on the board (n,), whether a place is looked at
// where a corner is seen (n, corners), quads (q, 8), places of a code (c, 2), least contrast, codes
// (c, m), found (3,)): how many places show their own marker; surely another one; and something
// like a marker that is not. How many quads were compared.
TRIGPOINT_KERNEL(tp_contradictions) {
    const PlanarFit fit = PlanarFit::unpacked(arguments[1].array.as<double>());
    const Array &cells = arguments[3].array, &quads = arguments[7].array,
                &given = arguments[10].array;
    const Eigen::Map<const Templates> codes(given.as<double>(), given.shape[0], given.shape[1]);
    std::vector<Place> places;
    for (std::int64_t i = 0; i < cells.shape[0]; ++i) {
        if (!is_reached(arguments[6].array, i, arguments[2].array)) continue;
        Place place{quad_at(cells, i),
                    {},
                    0,
                    arguments[4].array.as<const std::int64_t>()[i],
                    arguments[5].array.as<const std::uint8_t>()[i] != 0};
        if (place.marker >= codes.cols())
            throw std::invalid_argument("there is no marker of that number");
        for (Eigen::Vector2d& corner : place.corners) corner = fit.project(corner);
        place.middle = middle_of(place.corners);
        for (int k = 0; k < 4; ++k)
            place.side += (place.corners[(k + 3) % 4] - place.corners[k]).norm() / 4;
        places.push_back(place);
    }
    std::vector<Eigen::Vector2d> middles;
    for (std::int64_t row = 0; row < quads.shape[0]; ++row)
        middles.push_back(middle_of(quad_at(quads, row)));
    CellReader reader(Grey::of(arguments[0].array), arguments[8].array.rows<2>(),
                      arguments[9].number);
    Eigen::VectorXd code(codes.rows()), scores(codes.cols());
    std::vector<Seen> seen;
    bool is_sure = false;
    for (std::size_t i = 0; i < places.size(); ++i)
        for (std::int64_t row = 0; row < quads.shape[0]; ++row) {
            Place& place = places[i];
            const Eigen::Vector2d aside = middles[static_cast<std::size_t>(row)] - place.middle;
            if (!(aside.cwiseAbs().maxCoeff() < NEAR * place.side)) continue;
            const int first = first_at(quads, row, place);
            if (first < 0) continue;
            const bool is_any = reader.read(quad_at(quads, row, first), code);
            scores.noalias() = codes.transpose() * code;
            const double own = place.marker < 0 ? 0 : scores(place.marker);
            seen.push_back({i, own, scores.size() > 0 ? scores.maxCoeff() : 0, is_any});
            // A place is seen as several quadrilaterals: what agrees there settles it.
            place.agrees = place.agrees || own > PROBABLY;
            is_sure = is_sure || own > SURELY;
        }
    for (const Seen& quad : seen) {
        Place& place = places[quad.place];
        if (place.agrees) continue;
        // Where not one of its markers is surely read, what is not probably its own is none of it,
        // and what is like a marker beyond its edge is of a board that goes on.
        const bool is_other = is_sure ? quad.own < HARDLY && place.is_within : quad.own < PROBABLY;
        if (quad.best > SURELY)
            place.is_elsewhere = true;
        else if (is_other && quad.is_any)
            place.is_foreign = true;
    }
    auto* found = arguments[11].array.as<std::int64_t>();
    std::fill(found, found + 3, 0);
    for (const Place& place : places)
        found[0] += place.agrees, found[1] += place.is_elsewhere, found[2] += place.is_foreign;
    return static_cast<std::int64_t>(seen.size());
}
