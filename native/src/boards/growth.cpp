#include "boards/growth.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace trigpoint {
namespace {

constexpr float NONE = std::numeric_limits<float>::quiet_NaN();
constexpr int MOST_ROUNDS = 8;
// How often a grid's wild corners are dropped, the wildest first.
constexpr int MOST_DROPS = 4;
// A corner may lie this far from where those about it have it, of the distance to the next: a
// slanted board's squares shrink by a quarter from one to the next, and each prediction is off by
// half of that.
constexpr float MOST_OFF = 0.3F;
// A predicted corner may be this much weaker than one that nothing predicted.
constexpr float TOLERANCE = 1.7F;
constexpr float MARGIN_PX = 3.0F;
constexpr float PI = 3.14159265358979F;
constexpr int FREE = 2;  // places on every side of a lattice
constexpr std::array<std::array<int, 2>, 4> SIDES = {{{1, 0}, {0, 1}, {-1, 0}, {0, -1}}};

float length(Place step) { return std::hypot(step.x, step.y); }
Place minus(Place a, Place b) { return {a.x - b.x, a.y - b.y}; }
bool is_there(Place at) { return !std::isnan(at.x); }

// A grid's pixels by place, no number where it has none, with FREE places on every side.
class Lattice {
public:
    explicit Lattice(const Grid& grid) : extent_(Extent::of(grid)) {
        width_ = extent_.width() + 2 * FREE, height_ = extent_.height() + 2 * FREE;
        pixels_.assign(static_cast<std::size_t>(width_) * height_, {NONE, NONE});
        for (const GridCorner& corner : grid) pixels_[index(corner.x, corner.y)] = corner.pixel;
    }

    int left() const { return extent_.left - FREE; }
    int top() const { return extent_.top - FREE; }
    int right() const { return extent_.right + FREE; }
    int bottom() const { return extent_.bottom + FREE; }

    Place at(int x, int y) const {
        const bool is_inside = x >= left() && x <= right() && y >= top() && y <= bottom();
        return is_inside ? pixels_[index(x, y)] : Place{NONE, NONE};
    }

    // Where its neighbours have a place: the median of what every two beside it on a line, and
    // every three of a square, say, the lower one of two.
    Place predicted(int x, int y) const {
        std::array<float, 12> across, down;
        int count = 0;
        const auto say = [&](float by_x, float by_y) {
            if (std::isnan(by_x)) return;
            across[count] = by_x, down[count] = by_y;
            ++count;
        };
        for (const auto& [dx, dy] : SIDES) {
            const Place near = at(x + dx, y + dy);
            if (!is_there(near)) continue;
            const Place far = at(x + 2 * dx, y + 2 * dy), opposite = at(x - dx, y - dy);
            const Place beside = at(x - dy, y + dx), diagonal = at(x + dx - dy, y + dy + dx);
            say(2 * near.x - far.x, 2 * near.y - far.y);
            say(near.x + beside.x - diagonal.x, near.y + beside.y - diagonal.y);
            // Between two is twice as sure as beyond two, and they are met from both sides.
            say(0.5F * (near.x + opposite.x), 0.5F * (near.y + opposite.y));
        }
        if (count == 0) return {NONE, NONE};
        const int middle = (count - 1) / 2;
        std::nth_element(across.begin(), across.begin() + middle, across.begin() + count);
        std::nth_element(down.begin(), down.begin() + middle, down.begin() + count);
        return {across[middle], down[middle]};
    }

    // The step at a place along (dx, dy), by what lies before and behind it.
    Place slope(int x, int y, int dx, int dy) const {
        const Place here = at(x, y), ahead = minus(at(x + dx, y + dy), here),
                    behind = minus(here, at(x - dx, y - dy));
        if (!is_there(ahead)) return behind;
        if (!is_there(behind)) return ahead;
        return {0.5F * (ahead.x + behind.x), 0.5F * (ahead.y + behind.y)};
    }

    // How far it is from a place to the next ones, the shorter of both ways.
    float step(int x, int y) const {
        return std::fmin(length(slope(x, y, 1, 0)), length(slope(x, y, 0, 1)));
    }

    // The same with the free places where their neighbours have them.
    Lattice filled() const {
        Lattice full = *this;
        for (int y = top(); y <= bottom(); ++y) {
            for (int x = left(); x <= right(); ++x)
                if (!is_there(at(x, y))) full.pixels_[index(x, y)] = predicted(x, y);
        }
        return full;
    }

private:
    std::size_t index(int x, int y) const {
        return static_cast<std::size_t>(y - top()) * width_ + (x - left());
    }

    Extent extent_;
    int width_, height_;
    std::vector<Place> pixels_;
};

// Whether the sector of a corner that holds a direction is dark.
bool is_dark_towards(const Saddle& corner, Place towards) {
    const float angle = std::atan2(towards.y, towards.x);
    int best = 0;
    float least = std::numeric_limits<float>::infinity();
    for (int k = 0; k < 4; ++k) {
        float past = std::fmod(angle - corner.directions[k], 2 * PI);
        if (past < 0) past += 2 * PI;
        if (past < least) least = past, best = k;
    }
    return best % 2 == 1;
}

// Whether most corners say that the squares towards (-x, -y) of even places are dark.
bool even_is_dark(const Grid& grid) {
    int votes = 0;
    for (const GridCorner& corner : grid)
        votes += corner.is_dark == ((corner.x + corner.y) % 2 == 0) ? 1 : -1;
    return votes > 0;
}

// Adds the corners found in free places next to the grid's; whether there was one.
bool add_found_beside(Grid& grid, const Curvature& curvature) {
    const Lattice lattice(grid), full = lattice.filled();
    const bool even_dark = even_is_dark(grid);
    const float right = static_cast<float>(curvature.width() - 1) - MARGIN_PX,
                bottom = static_cast<float>(curvature.height() - 1) - MARGIN_PX;
    const std::size_t before = grid.size();
    for (int y = lattice.top(); y <= lattice.bottom(); ++y) {
        for (int x = lattice.left(); x <= lattice.right(); ++x) {
            const Place there = full.at(x, y);
            if (is_there(lattice.at(x, y)) || !is_there(there)) continue;
            const float step = full.step(x, y);
            const bool is_inside =
                there.x > MARGIN_PX && there.y > MARGIN_PX && there.x < right && there.y < bottom;
            Saddle found;
            if (!is_inside || !(step > 0) || !curvature.examine(there, TOLERANCE, found)) continue;
            const Place across = full.slope(x, y, 1, 0), down = full.slope(x, y, 0, 1);
            const bool is_dark = is_dark_towards(found, {-across.x - down.x, -across.y - down.y});
            const bool expected = (((x + y) % 2 == 0) == even_dark);
            if (length(minus(found.pixel, there)) < MOST_OFF * step && is_dark == expected)
                grid.push_back({x, y, found.pixel, is_dark});
        }
    }
    return grid.size() > before;
}

}  // namespace

Grid cleaned(Grid grid) {
    std::vector<float> off;
    for (int drop = 0; drop < MOST_DROPS && !grid.empty(); ++drop) {
        const Lattice lattice(grid);
        off.clear();
        float worst = 0;
        for (const GridCorner& corner : grid) {
            const Place expected = lattice.predicted(corner.x, corner.y);
            // Two corners in one place are a thousandth of a pixel apart.
            const float step = std::max(lattice.step(corner.x, corner.y), 1e-3F);
            const float share = length(minus(expected, corner.pixel)) / step;
            off.push_back(std::isnan(share) ? 0 : share);
            worst = std::max(worst, off.back());
        }
        if (worst <= MOST_OFF) break;
        const float limit = std::max(MOST_OFF, 0.7F * worst);
        std::size_t kept = 0;
        for (std::size_t i = 0; i < grid.size(); ++i)
            if (off[i] < limit) grid[kept++] = grid[i];
        grid.resize(kept);
    }
    return grid;
}

Grid grown(Grid grid, const Curvature& curvature, int longest) {
    for (int round = 0; round < MOST_ROUNDS; ++round) {
        const Extent extent = Extent::of(grid);
        if (grid.size() < LEAST_CORNERS || std::max(extent.width(), extent.height()) > longest + 1)
            break;
        Grid more = grid;
        if (!add_found_beside(more, curvature)) break;
        more = cleaned(std::move(more));
        // What was found is not the board's, and would be found again.
        if (more.size() <= grid.size()) break;
        grid = std::move(more);
    }
    return grid;
}

}  // namespace trigpoint
