#include "markers/quads.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace trigpoint {
namespace {

// How much darker than its surroundings a pixel must be, grey levels.
constexpr int DARKER = 7;
// Of the perimeter: how far a marker's edge may be from straight, and how short a side may be.
constexpr double POLYGON_ACCURACY = 0.05, LEAST_SIDE = 0.05;
constexpr double MARGIN_PX = 2;
// How many dark pieces a threshold may leave, by the beginnings of dark runs in rows, and how many
// of them are looked at. Pictures of rooms have up to 12 000 and 150; noise and chequered walls
// have 100 000 and 6000.
constexpr std::size_t MOST_RUNS = 30'000, MOST_PIECES = 800;
// More corners than a quadrilateral has, with some that are dropped again.
constexpr std::size_t MOST_CORNERS = 12;

// The eight pixels about one, clockwise from the right (y points down).
constexpr std::array<std::array<int, 2>, 8> AROUND = {
    {{1, 0}, {1, 1}, {0, 1}, {-1, 1}, {-1, 0}, {-1, -1}, {0, -1}, {1, -1}}};

// Adds one row to the sums of columns, and takes another away.
TRIGPOINT_WIDE
void slide(std::uint16_t* __restrict sums, const std::uint8_t* __restrict in,
           const std::uint8_t* __restrict out, std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x) sums[x] = std::uint16_t(sums[x] + in[x] - out[x]);
}

TRIGPOINT_WIDE
void brightest(const std::uint8_t* __restrict above, const std::uint8_t* __restrict here,
               const std::uint8_t* __restrict below, std::uint8_t* __restrict to,
               std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x)
        to[x] = std::max(here[x], std::max(above[x], below[x]));
}

// Whether pixels are darker by DARKER than the mean of `window` × `window`: (value + DARKER) ·
// window² <= sum; `sums`: of columns, with window / 2 more on both sides. In numbers of 16 bits,
// of which twice as many are compared at once.
template <int WINDOW>
inline __attribute__((always_inline)) void compare(const std::uint8_t* __restrict grey,
                                                   const std::uint16_t* __restrict sums,
                                                   std::uint8_t* __restrict dark,
                                                   std::int64_t count) {
    constexpr int AREA = WINDOW * WINDOW;
    static_assert((255 + DARKER) * AREA <= INT16_MAX);
    for (std::int64_t x = 0; x < count; ++x) {
        std::uint16_t sum = AREA / 2;
        for (int k = 0; k < WINDOW; ++k) sum = std::uint16_t(sum + sums[x + k]);
        const auto least = static_cast<std::int16_t>((grey[x] + DARKER) * AREA);
        dark[x] = static_cast<std::int16_t>(sum) >= least;
    }
}

TRIGPOINT_WIDE
void compare_5(const std::uint8_t* grey, const std::uint16_t* sums, std::uint8_t* dark,
               std::int64_t count) {
    compare<5>(grey, sums, dark, count);
}

TRIGPOINT_WIDE
void compare_11(const std::uint8_t* grey, const std::uint16_t* sums, std::uint8_t* dark,
                std::int64_t count) {
    compare<11>(grey, sums, dark, count);
}

// Half a picture's row: each pixel the mean of two by two.
TRIGPOINT_WIDE
void halve(const std::uint8_t* __restrict upper, const std::uint8_t* __restrict lower,
           std::uint8_t* __restrict to, std::int64_t count) {
    for (std::int64_t x = 0; x < count; ++x)
        to[x] = static_cast<std::uint8_t>(
            (upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1] + 2) / 4);
}

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return a.x() * b.y() - a.y() * b.x();
}

}  // namespace

Grey QuadSearch::shrunk(const Grey& grey, std::int64_t step) {
    const std::int64_t width = grey.width / step, height = grey.height / step;
    shrunk_.resize(width * height);
    const auto area = static_cast<std::int32_t>(step * step);
    for (std::int64_t y = 0; y < height; ++y) {
        std::uint8_t* to = shrunk_.data() + y * width;
        if (step == 2) {
            halve(grey.row(2 * y), grey.row(2 * y + 1), to, width);
            continue;
        }
        for (std::int64_t x = 0; x < width; ++x) {
            std::int32_t sum = area / 2;
            for (std::int64_t j = 0; j < step; ++j) {
                const std::uint8_t* from = grey.row(y * step + j) + x * step;
                for (std::int64_t i = 0; i < step; ++i) sum += from[i];
            }
            to[x] = static_cast<std::uint8_t>(sum / area);
        }
    }
    return {shrunk_.data(), height, width};
}

// Every pixel as bright as the brightest of the nine about it.
Grey QuadSearch::parted(const Grey& grey) {
    parted_.resize((grey.height + 1) * grey.width);
    std::uint8_t* line = parted_.data() + grey.height * grey.width;
    for (std::int64_t y = 0; y < grey.height; ++y) {
        brightest(grey.row(std::max<std::int64_t>(y - 1, 0)), grey.row(y),
                  grey.row(std::min(y + 1, grey.height - 1)), line, grey.width);
        std::uint8_t* to = parted_.data() + y * grey.width;
        to[0] = std::max(line[0], line[1]);
        to[grey.width - 1] = std::max(line[grey.width - 2], line[grey.width - 1]);
        brightest(line, line + 1, line + 2, to + 1, grey.width - 2);
    }
    return {parted_.data(), grey.height, grey.width};
}

void QuadSearch::threshold(const Grey& grey, int window) {
    width_ = grey.width, height_ = grey.height;
    const std::int64_t half = window / 2;
    dark_.resize((width_ + 2) * (height_ + 2));
    std::fill_n(dark_.begin(), width_ + 3, 0), std::fill_n(dark_.end() - width_ - 3, width_ + 3, 0);
    columns_.assign(width_ + 2 * half, 0);
    std::uint16_t* sums = columns_.data() + half;
    const auto row = [&](std::int64_t y) {
        return grey.row(std::clamp<std::int64_t>(y, 0, height_ - 1));
    };
    for (std::int64_t y = -half; y <= half; ++y) {
        for (std::int64_t x = 0; x < width_; ++x) sums[x] = std::uint16_t(sums[x] + row(y)[x]);
    }
    for (std::int64_t y = 0; y < height_; ++y) {
        if (y > 0) slide(sums, row(y + half), row(y - half - 1), width_);
        std::fill(columns_.begin(), columns_.begin() + half, sums[0]);
        std::fill(columns_.end() - half, columns_.end(), sums[width_ - 1]);
        if (window == 5)
            compare_5(grey.row(y), columns_.data(), dark(y), width_);
        else
            compare_11(grey.row(y), columns_.data(), dark(y), width_);
        dark(y)[width_] = dark(y)[width_ + 1] = 0;  // right of this row, and left of the next
    }
}

// The dark runs of all rows; whether they are few enough.
bool QuadSearch::find_runs() {
    runs_.clear();
    for (std::int64_t y = 0; y < height_; ++y) {
        const std::uint8_t *row = dark(y), *end = row + width_;
        for (const std::uint8_t* at = row; at != end;) {
            at = static_cast<const std::uint8_t*>(std::memchr(at, 1, end - at));
            if (at == nullptr) break;
            const auto* after = at + 1;
            while (*after != 0) ++after;  // most are short
            if (runs_.size() == MOST_RUNS) return false;
            runs_.push_back({static_cast<std::int32_t>(at - row),
                             static_cast<std::int32_t>(after - row), static_cast<std::int32_t>(y),
                             -1});
            at = after;
        }
    }
    return true;
}

std::int32_t QuadSearch::root(std::int32_t run) {
    while (parents_[run] != run) run = parents_[run] = parents_[parents_[run]];
    return run;
}

// The pieces that runs form which touch, also with their corners.
void QuadSearch::join_runs() {
    parents_.resize(runs_.size());
    std::iota(parents_.begin(), parents_.end(), 0);
    std::size_t above = 0;
    for (std::size_t i = 0; i < runs_.size(); ++i) {
        const Run& run = runs_[i];
        while (above < i && (runs_[above].row < run.row - 1 ||
                             (runs_[above].row == run.row - 1 && runs_[above].end < run.begin)))
            ++above;
        for (std::size_t j = above; j < i; ++j) {
            if (runs_[j].row != run.row - 1 || runs_[j].begin > run.end) break;
            const std::int32_t first = root(static_cast<std::int32_t>(j)),
                               second = root(static_cast<std::int32_t>(i));
            parents_[std::max(first, second)] = std::min(first, second);
        }
    }
    pieces_.clear();
    for (std::size_t i = 0; i < runs_.size(); ++i) {
        Run& run = runs_[i];
        const std::int32_t first = root(static_cast<std::int32_t>(i));
        if (first == static_cast<std::int32_t>(i)) {
            run.piece = static_cast<std::int32_t>(pieces_.size());
            pieces_.push_back({{run.begin, run.row}, run.begin, run.row, run.end - 1, run.row, 0});
        }
        run.piece = runs_[first].piece;
        Piece& piece = pieces_[run.piece];
        piece.left = std::min(piece.left, run.begin);
        piece.right = std::max(piece.right, run.end - 1);
        piece.bottom = run.row;
        piece.area += run.end - run.begin;
    }
}

bool QuadSearch::trace(const Piece& piece, std::size_t most) {
    outline_.clear();
    Point at = piece.first;
    const std::ptrdiff_t down = width_ + 2;
    std::array<std::ptrdiff_t, 8> steps;
    for (int k = 0; k < 8; ++k) steps[k] = AROUND[k][0] + AROUND[k][1] * down;
    const std::uint8_t* here = dark(at.y) + at.x;
    int from = 4;  // what is to the left of the first pixel of a first row is light
    int first_step = -1;
    while (outline_.size() < most) {
        int step = -1;
        for (int k = 1; k <= 8; ++k) {
            const int direction = (from + k) % 8;
            if (here[steps[direction]] != 0) {
                step = direction;
                break;
            }
        }
        if (step < 0) return false;  // one pixel alone
        if (at.x == piece.first.x && at.y == piece.first.y) {
            if (step == first_step) return true;
            first_step = first_step < 0 ? step : first_step;
        }
        outline_.push_back(at);
        at = {at.x + AROUND[step][0], at.y + AROUND[step][1]};
        here += steps[step];
        from = (step + 4) % 8;
    }
    return false;
}

// The convex quadrilateral that the outline is, if it is one: Douglas and Peucker (1973), begun at
// two points that are far apart, then without corners on a straight line.
void QuadSearch::add_quad_of_outline() {
    const std::size_t count = outline_.size();
    const double most = POLYGON_ACCURACY * static_cast<double>(count);
    const auto farthest = [&](std::size_t from) {
        std::size_t best = from;
        std::int64_t far = -1;
        for (std::size_t i = 0; i < count; ++i) {
            const std::int64_t dx = outline_[i].x - outline_[from].x,
                               dy = outline_[i].y - outline_[from].y;
            if (dx * dx + dy * dy > far) far = dx * dx + dy * dy, best = i;
        }
        return best;
    };
    const std::size_t first = farthest(farthest(0)), second = farthest(first);
    // Ends of stretches that are still to be split, the next one last.
    std::array<std::array<std::size_t, 2>, 2 * MOST_CORNERS> waiting;
    std::size_t left = 0;
    const std::size_t to = second > first ? second : second + count;
    waiting[left++] = {to, first + count};
    waiting[left++] = {first, to};
    std::array<Eigen::Vector2d, MOST_CORNERS> corners;
    std::size_t found = 0;
    const auto at = [&](std::size_t i) { return outline_[i < count ? i : i - count]; };
    while (left > 0) {
        const auto [begin, end] = waiting[--left];
        const Point a = at(begin), b = at(end);
        const std::int64_t along_x = b.x - a.x, along_y = b.y - a.y;
        std::int64_t far = 0;  // times the length
        std::size_t where = begin;
        for (std::size_t i = begin + 1; i < end; ++i) {
            const Point point = at(i);
            const std::int64_t off =
                std::abs(along_x * (point.y - a.y) - along_y * (point.x - a.x));
            if (off > far) far = off, where = i;
        }
        const double length = std::sqrt(static_cast<double>(along_x * along_x + along_y * along_y));
        if (static_cast<double>(far) > most * length) {
            if (left + 2 > waiting.size()) return;
            waiting[left++] = {where, end};
            waiting[left++] = {begin, where};
        } else {
            if (found == MOST_CORNERS) return;
            corners[found++] = {a.x, a.y};
        }
    }
    for (std::size_t i = 0; i < found && found > 4;) {
        const Eigen::Vector2d &before = corners[(i + found - 1) % found],
                              &after = corners[(i + 1) % found];
        const double length = std::max((after - before).norm(), 1e-9);
        if (std::abs(cross(after - before, corners[i] - before)) / length <= most) {
            std::move(corners.begin() + i + 1, corners.begin() + found, corners.begin() + i);
            --found;
        } else {
            ++i;
        }
    }
    if (found != 4) return;
    Quad quad;
    double perimeter = 0, shortest = 1e9;
    for (int k = 0; k < 4; ++k) {
        quad[k] = corners[k];
        const Eigen::Vector2d side = corners[(k + 1) % 4] - corners[k];
        const double longer = side.cwiseAbs().maxCoeff();
        perimeter += longer, shortest = std::min(shortest, longer);
        if (quad[k].minCoeff() < MARGIN_PX ||
            quad[k].x() > static_cast<double>(width_) - 1 - MARGIN_PX ||
            quad[k].y() > static_cast<double>(height_) - 1 - MARGIN_PX)
            return;
        // Clockwise and convex.
        if (cross(side, corners[(k + 2) % 4] - corners[(k + 1) % 4]) <= 0) return;
    }
    if (shortest >= LEAST_SIDE * perimeter) quads_.push_back(quad);
}

const std::vector<Quad>& QuadSearch::find(const Grey& grey, int window, double least_perimeter,
                                          bool parts_touching) {
    quads_.clear();
    if (grey.width < 2 * window || grey.height < 2 * window) return quads_;
    threshold(parts_touching ? parted(grey) : grey, window);
    if (!find_runs()) return quads_;
    join_runs();
    // The outline of a convex piece has no more points than that of its upright rectangle.
    const auto most = [](const Piece& piece) {
        return 2 * (piece.right - piece.left + piece.bottom - piece.top);
    };
    kept_.clear();
    for (std::size_t i = 0; i < pieces_.size(); ++i)
        if (most(pieces_[i]) >= least_perimeter) kept_.push_back(i);
    if (kept_.size() > MOST_PIECES) {
        std::nth_element(
            kept_.begin(), kept_.begin() + MOST_PIECES, kept_.end(),
            [&](std::size_t a, std::size_t b) { return most(pieces_[a]) > most(pieces_[b]); });
        kept_.resize(MOST_PIECES);
        std::sort(kept_.begin(), kept_.end());
    }
    for (const std::size_t i : kept_) {
        // Twice as many: outlines are rough.
        if (trace(pieces_[i], 2 * static_cast<std::size_t>(most(pieces_[i]))) &&
            static_cast<double>(outline_.size()) >= least_perimeter)
            add_quad_of_outline();
    }
    return quads_;
}

}  // namespace trigpoint
