#include "boards/placement.hpp"

#include <algorithm>
#include <array>
#include <tuple>
#include <utility>

namespace trigpoint {
namespace {

// By how many corners a place must be better than the next best one. A corner is seen on a board,
// or not seen elsewhere, nine times of ten: two of them are odds of 80.
constexpr int LEAST_LEAD = 2;
// Of the line after the last that is seen of a board, how much may be missing though it is in view.
constexpr double MOST_MISSING = 0.5;
// Corners nearer to the picture's edge than this are not found: the ring and the smoothing.
constexpr double MARGIN_PX = 4;

// A place of a board on a grid: its first place in the field and its extent. `count`: of its
// corners that are seen; `score`: those less the missing ones and those beside it.
struct Window {
    int score = 0, count = 0, left = 0, top = 0, width = 0, height = 0;

    bool has(int x, int y) const {
        return x >= left && x < left + width && y >= top && y < top + height;
    }
};

// Sums over rectangles of a table (Crow 1984).
class Sums {
public:
    Sums(const std::vector<char>& values, int width, int height) : width_(width + 1) {
        totals_.assign(static_cast<std::size_t>(width_) * (height + 1), 0);
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x)
                at(x + 1, y + 1) = values[static_cast<std::size_t>(y) * width + x] + at(x, y + 1) +
                                   at(x + 1, y) - at(x, y);
    }
    int of(int left, int top, int width, int height) const {
        return at(left + width, top + height) - at(left, top + height) - at(left + width, top) +
               at(left, top);
    }

private:
    int& at(int x, int y) { return totals_[static_cast<std::size_t>(y) * width_ + x]; }
    int at(int x, int y) const { return totals_[static_cast<std::size_t>(y) * width_ + x]; }

    int width_;
    std::vector<int> totals_;
};

// The places about a grid: which are seen, and which are missing though the picture has them.
class Field {
public:
    // All that are not seen are missing; `reach`: how far beyond the grid.
    Field(const Grid& grid, int reach) {
        const Extent extent = Extent::of(grid);
        left_ = extent.left - reach, top_ = extent.top - reach;
        width_ = extent.width() + 2 * reach, height_ = extent.height() + 2 * reach;
        seen_.assign(static_cast<std::size_t>(width_) * height_, 0);
        missing_.assign(seen_.size(), 1);
        for (const GridCorner& corner : grid) {
            const std::size_t place = index(corner.x - left_, corner.y - top_);
            seen_[place] = 1, missing_[place] = 0;
        }
    }

    // Missing are those alone that the picture has, by the fit.
    void keep_missing_within(const PlanarFit& fit, double width, double height) {
        for (int y = 0; y < height_; ++y) {
            for (int x = 0; x < width_; ++x) {
                if (!missing_[index(x, y)]) continue;
                const Eigen::Vector2d pixel = fit.project({double(x + left_), double(y + top_)});
                const bool is_inside = pixel.minCoeff() > MARGIN_PX &&
                                       pixel.x() < width - 1 - MARGIN_PX &&
                                       pixel.y() < height - 1 - MARGIN_PX;
                missing_[index(x, y)] = is_inside;
            }
        }
    }

    // The two best places of a board, either way up.
    std::array<Window, 2> best(const BoardShape& shape) const {
        const Sums seen(seen_, width_, height_), missing(missing_, width_, height_);
        std::array<Window, 2> found;
        found.fill({-1'000'000});
        for (const bool is_turned : {false, true}) {
            if (is_turned && shape.columns == shape.rows) break;
            const int width = is_turned ? shape.rows : shape.columns;
            const int height = is_turned ? shape.columns : shape.rows;
            for (int y = 0; y + height <= height_; ++y) {
                for (int x = 0; x + width <= width_; ++x) {
                    const int count = seen.of(x, y, width, height);
                    int score = count - missing.of(x, y, width, height);
                    // At the field's edge there is nothing beside.
                    if (x > 0 && y > 0 && x + width < width_ && y + height < height_)
                        score -= seen.of(x - 1, y - 1, width + 2, height + 2) - count;
                    const Window window{score, count, x, y, width, height};
                    if (score > found[0].score) {
                        found[1] = found[0], found[0] = window;
                    } else if (score > found[1].score) {
                        found[1] = window;
                    }
                }
            }
        }
        return found;
    }

    // Whether what is seen of a window ends at a line that most of the next one is missing after:
    // another board's end, or one of a board that leaves its place open.
    bool shows_an_end(const Window& window) const {
        for (const bool is_down : {false, true}) {
            const int lines = is_down ? window.height : window.width;
            const int length = is_down ? window.width : window.height;
            std::vector<double> share(static_cast<std::size_t>(lines), 0);
            int low = lines, high = -1;
            for (int line = 0; line < lines; ++line) {
                for (int k = 0; k < length; ++k) {
                    const std::size_t place = is_down ? index(window.left + k, window.top + line)
                                                      : index(window.left + line, window.top + k);
                    share[line] += missing_[place] / double(length);
                    if (seen_[place]) low = std::min(low, line), high = line;
                }
            }
            if (low > 0 && low <= lines && share[low - 1] > MOST_MISSING) return true;
            if (high + 1 < lines && share[high + 1] > MOST_MISSING) return true;
        }
        return false;
    }

    // The window in the grid's places.
    Window in_places(Window window) const {
        window.left += left_, window.top += top_;
        return window;
    }

private:
    std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * width_ + x; }

    int left_, top_, width_, height_;
    std::vector<char> seen_, missing_;
};

// How far a grid's x, turned by quarters, runs to the picture's right and its y down: the sum of
// two cosines.
double uprightness(const Grid& grid, const std::vector<std::size_t>& board, int quarters) {
    Eigen::Vector2d place_mean(0, 0), pixel_mean(0, 0);
    const auto place_of = [&](const GridCorner& corner) {
        Eigen::Vector2d place(corner.x, corner.y);
        for (int turn = 0; turn < quarters; ++turn) place = Eigen::Vector2d(-place.y(), place.x());
        return place;
    };
    const double share = 1 / double(board.size());
    for (const std::size_t i : board) {
        place_mean += share * place_of(grid[i]);
        pixel_mean += share * Eigen::Vector2d(grid[i].pixel.x, grid[i].pixel.y);
    }
    Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
    for (const std::size_t i : board)
        spread += (place_of(grid[i]) - place_mean) *
                  (Eigen::Vector2d(grid[i].pixel.x, grid[i].pixel.y) - pixel_mean).transpose();
    return spread(0, 0) / spread.row(0).norm() + spread(1, 1) / spread.row(1).norm();
}

// How often a window is turned by a quarter (never mirrored) until it is as wide as the board and
// the square at the top left is dark, or light on an inverted board; of two such turns the one
// more upright in the picture, none where the colours are another board's.
std::optional<int> turns(const Grid& grid, const std::vector<std::size_t>& board,
                         const Window& window, const BoardShape& shape) {
    // Colours alternate with each step and with each quarter turn; most of the corners decide.
    int dark = 0;
    for (const std::size_t i : board) {
        const bool is_odd = (grid[i].x - window.left + grid[i].y - window.top) % 2 != 0;
        dark += grid[i].is_dark != is_odd ? 1 : -1;
    }
    std::optional<int> best;
    double most = 0;
    int width = window.width, height = window.height, flips = 0;
    for (int quarters = 0; quarters < 4; ++quarters) {
        const bool is_dark = flips % 2 ? dark < 0 : dark > 0;
        if (width == shape.columns && height == shape.rows && is_dark != shape.is_inverted) {
            const double upright = uprightness(grid, board, quarters);
            if (!best || upright > most) best = quarters, most = upright;
        }
        flips += height;  // of the turn, and of height - 1 steps to another corner
        std::swap(width, height);
    }
    return best;
}

}  // namespace

std::optional<Placement> placed(const Grid& grid, const BoardShape& shape, double width,
                                double height, double least_share, const FitOfPlaces& fit_of) {
    const double enough = least_share * shape.count();
    Field field(grid, std::max(shape.columns, shape.rows));
    auto best = field.best(shape);
    if (best[0].count < enough) return std::nullopt;
    if (best[0].score < shape.count()) {
        const auto fit = fit_of();
        if (!fit) return std::nullopt;
        field.keep_missing_within(*fit, width, height);
        best = field.best(shape);
    }
    const Window& first = best[0];
    if (first.count < enough || best[1].score > first.score - LEAST_LEAD ||
        field.shows_an_end(first))
        return std::nullopt;
    const Window window = field.in_places(first);
    std::vector<std::size_t> board;
    for (std::size_t i = 0; i < grid.size(); ++i)
        if (window.has(grid[i].x, grid[i].y)) board.push_back(i);
    const auto quarters = turns(grid, board, window, shape);
    if (!quarters) return std::nullopt;
    Placement found{std::vector<int>(grid.size(), -1), first.score};
    for (const std::size_t i : board) {
        int x = grid[i].x - window.left, y = grid[i].y - window.top;
        int across = window.width, down = window.height;
        for (int turn = 0; turn < *quarters; ++turn) {
            // The old y runs along the new x backwards.
            std::tie(x, y) = std::pair(down - 1 - y, x);
            std::swap(across, down);
        }
        found.ids[i] = y * shape.columns + x;
    }
    return found;
}

}  // namespace trigpoint
