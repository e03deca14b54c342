#include "boards/evidence.hpp"

#include <cmath>
#include <limits>

namespace trigpoint {
namespace {

// How often a step from square to square is there: on a board, some of which gleam or are hidden;
// and elsewhere, where it must be one way round and a quarter of the contrast.
constexpr double ON_BOARD = 0.88, BY_CHANCE = 0.3, LEAST_STEP = 0.25;
// Odds against clutter that a sighting needs: a picture offers some ten grids, of ten thousand
// pictures none may show a board that is not there.
constexpr double PICTURES = 10'000, GRIDS = 10;
// Of a square, how far a corner is off against those beside it: on a board, whose paper is not flat
// (of 500 real ones most are off by 0.002, one by 0.02), with what a pixel's grain adds, pixels;
// and in clutter where it is not even, which it is or is not as often.
constexpr double EVEN_SHARE = 0.01, GRAIN_PX = 0.05, UNEVEN_SHARE = 0.1, EVEN_BY_CHANCE = 0.5;
// How far beyond the outermost corners the outermost squares are looked at, squares: some are
// narrow or cut. How far beyond those a board that goes on is: less than the white around most
// boards, and little where the picture ends there.
constexpr double OUTER_SQUARES = 0.4;
constexpr std::array<double, 2> END_SQUARES{1.25, 1.1};
constexpr double NONE = std::numeric_limits<double>::quiet_NaN();

// What so many steps of `total` that are as printed say for a board, nats.
double nats(int right, int total) {
    static const double for_it = std::log(ON_BOARD / BY_CHANCE),
                        against = std::log((1 - ON_BOARD) / (1 - BY_CHANCE));
    return right * for_it + (total - right) * against;
}

double middle_of(std::vector<double>& values, double if_none) {
    return values.empty() ? if_none : median(values);
}

// Looks at a board's squares, which are one more each way than its corners.
class Squares {
public:
    Squares(const Grey& grey, const BoardShape& shape, const PlanarFit& fit)
        : grey_(grey), fit_(fit), columns_(shape.columns + 1), rows_(shape.rows + 1) {
        for (int row = 0; row < rows_; ++row)
            for (int column = 0; column < columns_; ++column)
                rising_.push_back(seen(middle(column, columns_), middle(row, rows_), column + row));
        std::vector<double> steps;
        for (int row = 0; row < rows_; ++row) {
            for (int column = 0; column < columns_; ++column) {
                const double here = rising(column, row);
                for (const double next : {column + 1 < columns_ ? rising(column + 1, row) : NONE,
                                          row + 1 < rows_ ? rising(column, row + 1) : NONE})
                    if (!std::isnan(here + next)) steps.push_back(-(here + next));
            }
        }
        // At least a grey level, so that nothing is a step where all is alike.
        contrast_ = std::max(1.0, middle_of(steps, 1));
    }

    // Of the squares beside the corners `ids`: how many differ from the mean of their neighbours,
    // which are such too, as they should, and of how many that can be said.
    double board(const std::vector<int>& ids) const {
        std::vector<char> known(rising_.size(), 0);
        for (const int id : ids) {
            const int column = id % (columns_ - 1), row = id / (columns_ - 1);
            for (const int beside : {0, 1, columns_, columns_ + 1}) {
                const auto at = static_cast<std::size_t>(row * columns_ + column + beside);
                known[at] = !std::isnan(rising_[at]);
            }
        }
        int right = 0, told = 0;
        for (int row = 0; row < rows_; ++row) {
            for (int column = 0; column < columns_; ++column) {
                if (!known[static_cast<std::size_t>(row * columns_ + column)]) continue;
                double total = 0;
                int count = 0;
                const auto add = [&](int x, int y) {
                    const bool is_one = x >= 0 && y >= 0 && x < columns_ && y < rows_ &&
                                        known[static_cast<std::size_t>(y * columns_ + x)];
                    if (is_one) total += rising(x, y), ++count;
                };
                add(column - 1, row), add(column + 1, row), add(column, row - 1),
                    add(column, row + 1);
                if (count == 0) continue;
                ++told;
                right += -(rising(column, row) + total / count) > LEAST_STEP * contrast_;
            }
        }
        return nats(right, told);
    }

    // The odds that a board ends at one side, by the squares that a larger one would have there:
    // the least that any line of them says. `is_down`: whether the side is crossed going down.
    double end(bool is_down, bool is_last) const {
        const int across = is_down ? rows_ : columns_, along = is_down ? columns_ : rows_;
        double least = std::numeric_limits<double>::infinity();
        for (const double beyond : END_SQUARES) {
            const double far = is_last ? across - 2 + beyond : -beyond;
            const int place = is_last ? across : -1;
            int goes_on = 0, total = 0;
            double before = NONE;
            for (int k = 0; k < along; ++k) {
                const double at = middle(k, along);
                const double here = is_down ? seen(at, far, k + place) : seen(far, at, k + place);
                if (!std::isnan(before + here)) {
                    ++total;
                    goes_on += -(before + here) > LEAST_STEP * contrast_;
                }
                before = here;
            }
            least = std::min(least, -nats(goes_on, total));
        }
        return least;
    }

private:
    // Where a square is looked at, squares from corner 0.
    static double middle(int square, int count) {
        if (square == 0) return -OUTER_SQUARES;
        return square == count - 1 ? count - 2 + OUTER_SQUARES : square - 0.5;
    }
    // The grey value at a place; light squares, whose number is even, count as negative, and what
    // is not in the picture is not a number.
    double seen(double x, double y, int number) const {
        const Eigen::Vector2d pixel = fit_.project({x, y});
        const bool is_inside = pixel.minCoeff() >= 0 && pixel.x() <= double(grey_.width - 1) &&
                               pixel.y() <= double(grey_.height - 1);
        if (!is_inside) return NONE;
        const double value = grey_.at(float(pixel.x()), float(pixel.y()));
        return number % 2 == 0 ? value : -value;
    }
    double rising(int column, int row) const {
        return rising_[static_cast<std::size_t>(row * columns_ + column)];
    }

    const Grey& grey_;
    const PlanarFit& fit_;
    int columns_, rows_;
    std::vector<double> rising_;
    double contrast_;
};

// Log odds of a board by how evenly its corners lie, nats: of each against the next ones, which a
// lens or a curl that the fit does not have moves alike. 0 where none lie side by side.
double evenness(const BoardShape& shape, const PlanarFit& fit, const std::vector<int>& ids,
                const std::vector<Eigen::Vector2d>& pixels) {
    const auto count = static_cast<std::size_t>(shape.count());
    std::vector<Eigen::Vector2d> expected(count), off(count, {NONE, NONE});
    for (std::size_t i = 0; i < ids.size(); ++i) {
        const auto id = static_cast<std::size_t>(ids[i]);
        expected[id] =
            fit.project({double(ids[i] % shape.columns), double(ids[i] / shape.columns)});
        off[id] = pixels[i] - expected[id];
    }
    std::vector<double> steps;
    double uneven = 0;
    const auto add = [&](std::size_t first, std::size_t second) {
        const Eigen::Vector2d change = off[second] - off[first];
        if (!change.allFinite()) return;
        uneven += change.squaredNorm();
        steps.push_back((expected[second] - expected[first]).norm());
    };
    for (int row = 0; row < shape.rows; ++row) {
        for (int column = 0; column < shape.columns; ++column) {
            const auto here = static_cast<std::size_t>(row * shape.columns + column);
            if (column + 1 < shape.columns) add(here, here + 1);
            if (row + 1 < shape.rows) add(here, here + static_cast<std::size_t>(shape.columns));
        }
    }
    if (steps.empty()) return 0;
    // Of a coordinate of one corner: each difference has two of both.
    const double mean = uneven / (4 * double(steps.size())), spacing = median(steps);
    const double variance = mean / (spacing * spacing), grain = GRAIN_PX / spacing;
    const double even = EVEN_SHARE * EVEN_SHARE + grain * grain;
    const double chance = UNEVEN_SHARE * UNEVEN_SHARE;
    const double told =
        double(ids.size()) * (std::log(chance / even) - variance * (1 / even - 1 / chance));
    const double by_chance = std::log(EVEN_BY_CHANCE),
                 by_print = std::log1p(-EVEN_BY_CHANCE) - told;
    const double most = std::max(by_chance, by_print);
    return -(most + std::log(std::exp(by_chance - most) + std::exp(by_print - most)));
}

}  // namespace

bool Evidence::is_board() const {
    static const double least = std::log(GRIDS * PICTURES);
    return board >= least && *std::min_element(ends.begin(), ends.end()) >= 0;
}

Evidence weighed(const Grey& grey, const BoardShape& shape, const PlanarFit& fit,
                 const std::vector<int>& ids, const std::vector<Eigen::Vector2d>& pixels) {
    const Squares squares(grey, shape, fit);
    Evidence found;
    found.board = squares.board(ids) + evenness(shape, fit, ids, pixels);
    found.ends = {squares.end(true, false), squares.end(true, true), squares.end(false, false),
                  squares.end(false, true)};
    return found;
}

}  // namespace trigpoint
