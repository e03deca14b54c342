#include "markers/quads.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

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

// How far points lie from one of them, squared, or from the line that leads from it along another,
// times the length of that: `off`, and the most of that.
template <bool IS_LINE>
inline __attribute__((always_inline)) std::int32_t measure(
    const std::int32_t* __restrict xs, const std::int32_t* __restrict ys, std::size_t count,
    std::int32_t from_x, std::int32_t from_y, std::int32_t along_x, std::int32_t along_y,
    std::int32_t* __restrict off) {
    std::int32_t most = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const std::int32_t x = xs[i] - from_x, y = ys[i] - from_y;
        const std::int32_t across = along_x * y - along_y * x;
        const std::int32_t value = IS_LINE ? (across < 0 ? -across : across) : x * x + y * y;
        off[i] = value;
        most = value > most ? value : most;
    }
    return most;
}

TRIGPOINT_WIDE
std::int32_t off_point(const std::int32_t* xs, const std::int32_t* ys, std::size_t count,
                       std::int32_t x, std::int32_t y, std::int32_t* off) {
    return measure<false>(xs, ys, count, x, y, 0, 0, off);
}

TRIGPOINT_WIDE
std::int32_t off_line(const std::int32_t* xs, const std::int32_t* ys, std::size_t count,
                      std::int32_t x, std::int32_t y, std::int32_t along_x, std::int32_t along_y,
                      std::int32_t* off) {
    return measure<true>(xs, ys, count, x, y, along_x, along_y, off);
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

std::int32_t QuadSearch::root(std::int32_t run) {
    while (runs_[run].piece != run) run = runs_[run].piece = runs_[runs_[run].piece].piece;
    return run;
}

// The dark runs of all rows, each with one of its piece that came before, the first with itself:
// those that touch, also with their corners; whether they are few enough.
bool QuadSearch::find_runs() {
    runs_.clear();
    changes_.resize(width_ + 2);
    std::size_t above = 0;
    for (std::int64_t y = 0; y < height_; ++y) {
        // Where a run begins, where it ends, and so on; eight pixels at once, the first in the
        // lowest byte.
        std::int32_t* end = changes_.data();
        for (std::int64_t x = 0; x <= width_; x += 8) {
            std::uint64_t here, before;
            std::memcpy(&here, dark(y) + x, 8), std::memcpy(&before, dark(y) + x - 1, 8);
            for (std::uint64_t left = here ^ before; left != 0; left &= left - 1) {
                const std::int64_t at = x + __builtin_ctzll(left) / 8;
                if (at > width_) break;
                *end++ = static_cast<std::int32_t>(at);
            }
        }
        const std::size_t first = runs_.size();
        std::size_t near = above;
        for (const std::int32_t* change = changes_.data(); change != end; change += 2) {
            if (runs_.size() == MOST_RUNS) return false;
            const auto own = static_cast<std::int32_t>(runs_.size());
            Run run{change[0], change[1], static_cast<std::int32_t>(y), own};
            while (near < first && runs_[near].end < run.begin) ++near;
            for (std::size_t j = near; j < first && runs_[j].begin <= run.end; ++j) {
                const std::int32_t other = root(static_cast<std::int32_t>(j));
                if (run.piece != own)
                    runs_[std::max(run.piece, other)].piece = std::min(run.piece, other);
                run.piece = std::min(run.piece, other);
            }
            runs_.push_back(run);
        }
        above = first;
    }
    return true;
}

// The pieces that runs form.
void QuadSearch::join_runs() {
    pieces_.clear();
    for (std::size_t i = 0; i < runs_.size(); ++i) {
        Run& run = runs_[i];
        if (run.piece == static_cast<std::int32_t>(i)) {
            run.piece = static_cast<std::int32_t>(pieces_.size());
            pieces_.push_back({{run.begin, run.row}, run.begin, run.row, run.end - 1, run.row});
        } else {
            run.piece = runs_[run.piece].piece;
        }
        Piece& piece = pieces_[run.piece];
        piece.left = std::min(piece.left, run.begin);
        piece.right = std::max(piece.right, run.end - 1);
        piece.bottom = run.row;
    }
}

bool QuadSearch::trace(const Piece& piece, std::size_t most) {
    outline_.resize(most + 1);
    std::size_t count = 0;
    Point at = piece.first;
    const std::ptrdiff_t down = width_ + 2;
    std::array<std::ptrdiff_t, 8> steps;
    for (int k = 0; k < 8; ++k) steps[k] = AROUND[k][0] + AROUND[k][1] * down;
    const std::uint8_t* here = dark(at.y) + at.x;
    int from = 4;  // what is to the left of the first pixel of a first row is light
    int first_step = -1;
    while (count < most) {
        unsigned about = 0;
        for (int k = 0; k < 8; ++k) about |= unsigned{here[steps[k]]} << k;
        if (about == 0) return false;  // one pixel alone
        // The first one clockwise after that.
        const int next = (from + 1) % 8;
        const int step = (next + __builtin_ctz((about | about << 8) >> next)) % 8;
        if (at.x == piece.first.x && at.y == piece.first.y) {
            if (step == first_step) {
                outline_.resize(count);
                return true;
            }
            first_step = first_step < 0 ? step : first_step;
        }
        outline_.put(count++, at);
        at = {at.x + AROUND[step][0], at.y + AROUND[step][1]};
        here += steps[step];
        from = (step + 4) % 8;
    }
    return false;
}

// The convex quadrilateral that the outline is, if it is one: Douglas and Peucker (1973), begun at
// two points that are far apart, then without corners on a straight line.
void QuadSearch::add_quad_of_outline() {
    const std::size_t count = outline_.x.size();
    const double most = POLYGON_ACCURACY * static_cast<double>(count);
    auto& [xs, ys] = outline_;
    off_.resize(count);
    const auto first_of = [&](std::int32_t value) {
        return static_cast<std::size_t>(std::find(off_.begin(), off_.end(), value) - off_.begin());
    };
    const auto farthest = [&](std::size_t from) {
        return first_of(off_point(xs.data(), ys.data(), count, xs[from], ys[from], off_.data()));
    };
    // From the first of the two on, which is there once more at the end.
    const std::size_t first = farthest(farthest(0)), second = farthest(first);
    const std::size_t to = second > first ? second - first : second + count - first;
    for (auto* line : {&xs, &ys}) {
        std::rotate(line->begin(), line->begin() + static_cast<std::ptrdiff_t>(first), line->end());
        line->push_back(line->front());
    }
    // Ends of stretches that are still to be split, the next one last.
    std::array<std::array<std::size_t, 2>, 2 * MOST_CORNERS> waiting;
    std::size_t left = 0;
    waiting[left++] = {to, count};
    waiting[left++] = {0, to};
    std::array<Eigen::Vector2d, MOST_CORNERS> corners;
    std::size_t found = 0;
    while (left > 0) {
        const auto [begin, end] = waiting[--left];
        const std::int32_t along_x = xs[end] - xs[begin], along_y = ys[end] - ys[begin];
        const std::int32_t far = off_line(&xs[begin], &ys[begin], end - begin, xs[begin], ys[begin],
                                          along_x, along_y, off_.data());
        const double length = std::sqrt(static_cast<double>(along_x * along_x + along_y * along_y));
        if (static_cast<double>(far) > most * length) {
            if (left + 2 > waiting.size()) return;
            const std::size_t where = begin + first_of(far);
            waiting[left++] = {where, end};
            waiting[left++] = {begin, where};
        } else {
            if (found == MOST_CORNERS) return;
            corners[found++] = {xs[begin], ys[begin]};
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
            static_cast<double>(outline_.x.size()) >= least_perimeter)
            add_quad_of_outline();
    }
    return quads_;
}

}  // namespace trigpoint
