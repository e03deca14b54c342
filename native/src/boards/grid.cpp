#include "boards/grid.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <unordered_map>

namespace trigpoint {
namespace {

// Next corners are among the nearest 14 also where squares are seen aslant as 1 : 3.
constexpr std::size_t NEAREST = 14;
// Where squares are small, the next ones bend a corner's edges by up to 30 degrees.
constexpr float LEAST_COSINE = 0.76604444F;  // of 40 degrees
// Of a step against the opposite one: perspective shrinks a slanted board's by a quarter.
constexpr float LONGEST_RATIO = 2.2F;
// Of a step, how much the next one and those beside it may differ.
constexpr float MOST_CHANGED = 0.5F;
// Steps of the four directions of a corner: x, y, -x, -y.
constexpr std::array<std::array<int, 2>, 4> STEPS = {{{1, 0}, {0, 1}, {-1, 0}, {0, -1}}};

// By direction: the next corner, -1 without one, and which of its directions points back.
struct Link {
    int to = -1, back = 0;
};
using Links = std::array<Link, 4>;

// Corners in square cells of a picture, cell by cell, to find the nearest ones.
class Cells {
public:
    struct Near {
        float squared, x, y;
        int corner;

        // Of two that are as near, the one with the lower number, whoever sorts them.
        bool operator<(const Near& other) const {
            return std::tie(squared, corner) < std::tie(other.squared, other.corner);
        }
    };

    explicit Cells(const std::vector<Saddle>& saddles)
        : all_(saddles.size()), found_(saddles.size() + 1) {
        Place low = saddles[0].pixel, high = low;
        for (const Saddle& saddle : saddles) {
            low = {std::min(low.x, saddle.pixel.x), std::min(low.y, saddle.pixel.y)};
            high = {std::max(high.x, saddle.pixel.x), std::max(high.y, saddle.pixel.y)};
        }
        low_ = low;
        const float area = (high.x - low.x + 1) * (high.y - low.y + 1);
        side_ = std::max(1.0F, std::sqrt(area * A_CELL / static_cast<float>(saddles.size())));
        columns_ = column_of(high.x) + 1, rows_ = row_of(high.y) + 1;
        first_.assign(static_cast<std::size_t>(columns_) * rows_ + 1, 0);
        const auto cell = [&](Place at) { return row_of(at.y) * columns_ + column_of(at.x); };
        for (const Saddle& saddle : saddles) ++first_[cell(saddle.pixel) + 1];
        for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
        std::vector<int> next(first_.begin(), first_.end() - 1);
        for (std::size_t i = 0; i < saddles.size(); ++i)
            all_[next[cell(saddles[i].pixel)]++] = {saddles[i].pixel, static_cast<int>(i)};
    }

    struct Nears {
        const Near *first, *last;

        const Near* begin() const { return first; }
        const Near* end() const { return last; }
    };

    // The NEAREST corners of one, in no order, with where they lie from it.
    Nears about(int corner, Place here) {
        const int column = column_of(here.x), row = row_of(here.y);
        const int whole = std::max(columns_, rows_);
        for (int reach = 1;; ++reach) {
            // What lies in no cell that is looked at is further than this.
            const float sure = static_cast<float>(reach) * side_;
            const float most = reach >= whole ? INFINITY : sure * sure;
            const int from = std::max(column - reach, 0),
                      to = std::min(column + reach, columns_ - 1);
            const int top = std::max(row - reach, 0), bottom = std::min(row + reach, rows_ - 1);
            std::size_t held = 0;
            for (int y = top; y <= bottom; ++y)
                held += static_cast<std::size_t>(first_[y * columns_ + to + 1] -
                                                 first_[y * columns_ + from]);
            // Not all of the cells' corners are near enough.
            if (3 * held < 4 * NEAREST && reach < whole) continue;
            Near* end = found_.data();
            for (int y = top; y <= bottom; ++y) {
                for (int i = first_[y * columns_ + from]; i < first_[y * columns_ + to + 1]; ++i) {
                    const float x_off = all_[i].pixel.x - here.x, y_off = all_[i].pixel.y - here.y;
                    const float squared = x_off * x_off + y_off * y_off;
                    *end = {squared, x_off, y_off, all_[i].corner};
                    end += (squared <= most) & (all_[i].corner != corner);
                }
            }
            const auto count = static_cast<std::size_t>(end - found_.data());
            if (count < NEAREST && reach < whole) continue;
            if (count > NEAREST) {
                end = found_.data() + NEAREST;
                std::nth_element(found_.data(), end, found_.data() + count);
            }
            return {found_.data(), end};
        }
    }

private:
    static constexpr float A_CELL = 0.7F;  // corners, on average; they come in crowds

    struct Member {
        Place pixel;
        int corner;
    };

    int column_of(float x) const { return static_cast<int>((x - low_.x) / side_); }
    int row_of(float y) const { return static_cast<int>((y - low_.y) / side_); }

    Place low_{};
    float side_ = 1;
    int columns_ = 1, rows_ = 1;
    std::vector<int> first_;
    std::vector<Member> all_;
    std::vector<Near> found_;
};

// Unit vectors along directions 0 and 1 of a corner; 2 and 3 are their opposites.
struct Axes {
    float x[2], y[2];
};

// Which direction of a corner is nearest to a step; -1 where none is near enough.
int direction_towards(const Axes& axes, float x, float y, float squared) {
    const float first = axes.x[0] * x + axes.y[0] * y, second = axes.x[1] * x + axes.y[1] * y;
    const bool is_second = std::abs(second) > std::abs(first);
    const float best = is_second ? second : first;
    const bool is_near = best * best > LEAST_COSINE * LEAST_COSINE * squared;
    return is_near ? is_second + 2 * (best < 0) : -1;
}

// Each corner's nearest fitting neighbour by direction.
std::vector<Links> chosen(const std::vector<Saddle>& saddles) {
    std::vector<Axes> axes(saddles.size());
    for (std::size_t i = 0; i < saddles.size(); ++i) {
        for (int k = 0; k < 2; ++k) {
            axes[i].x[k] = std::cos(saddles[i].directions[k]);
            axes[i].y[k] = std::sin(saddles[i].directions[k]);
        }
    }
    Cells cells(saddles);
    std::vector<Links> links(saddles.size());
    for (std::size_t i = 0; i < saddles.size(); ++i) {
        const auto about = cells.about(static_cast<int>(i), saddles[i].pixel);
        std::array<const Cells::Near*, 4> nearest{};
        for (const auto& near : about) {
            const int ahead = direction_towards(axes[i], near.x, near.y, near.squared);
            if (ahead < 0 || (nearest[ahead] && *nearest[ahead] < near)) continue;
            const int behind = direction_towards(axes[near.corner], -near.x, -near.y, near.squared);
            if (behind < 0 || (ahead + behind) % 2 == 0) continue;
            links[i][ahead] = {near.corner, behind};
            nearest[ahead] = &near;
        }
    }
    return links;
}

float length(float x, float y) { return std::sqrt(x * x + y * y); }

float distance(const Saddle& first, const Saddle& second) {
    return length(first.pixel.x - second.pixel.x, first.pixel.y - second.pixel.y);
}

// Links that both ends chose, without those much longer than the opposite one at the same corner.
std::vector<Links> mutual_links(const std::vector<Saddle>& saddles) {
    const std::vector<Links> all = chosen(saddles);
    std::vector<Links> mutual(all.size());
    for (std::size_t i = 0; i < all.size(); ++i) {
        for (int k = 0; k < 4; ++k) {
            const Link link = all[i][k];
            if (link.to < 0) continue;
            const Link returning = all[link.to][link.back];
            if (returning.to == static_cast<int>(i) && returning.back == k) mutual[i][k] = link;
        }
    }
    std::vector<Links> kept = mutual;
    for (std::size_t i = 0; i < mutual.size(); ++i) {
        for (int k = 0; k < 4; ++k) {
            const Link link = mutual[i][k], opposite = mutual[i][(k + 2) % 4];
            if (link.to < 0 || opposite.to < 0) continue;
            if (distance(saddles[link.to], saddles[i]) >
                LONGEST_RATIO * distance(saddles[opposite.to], saddles[i]))
                kept[i][k] = kept[link.to][link.back] = Link{};
        }
    }
    return kept;
}

// Walks the links from a corner on.
class Walk {
public:
    Walk(const std::vector<Saddle>& saddles, const std::vector<Links>& links)
        : saddles_(saddles), links_(links), seen_(saddles.size()) {}

    bool has_seen(int corner) const { return seen_[corner]; }

    // The grid that links reach from the seed. A corner whose place is taken, or that would get two
    // places, is left where it was first put; one that does not go on as the grid does belongs to
    // another board.
    Grid from(int seed) {
        taken_.clear();
        std::deque<Placed> waiting;
        Grid grid;
        const auto put = [&](Placed corner) {
            taken_[key(corner.x, corner.y)] = saddles_[corner.index].pixel;
            seen_[corner.index] = true;
            waiting.push_back(corner);
            // The sector from direction 2 to 3 of an unturned corner is light, as is 0 to 1.
            grid.push_back(
                {corner.x, corner.y, saddles_[corner.index].pixel, corner.turn % 2 == 1});
        };
        put({seed, 0, 0, 0});
        while (!waiting.empty()) {
            const Placed here = waiting.front();
            waiting.pop_front();
            for (int k = 0; k < 4; ++k) {
                const Link link = links_[here.index][k];
                if (link.to < 0 || seen_[link.to]) continue;
                const int step = (k - here.turn + 4) % 4;
                const Placed next{link.to, here.x + STEPS[step][0], here.y + STEPS[step][1],
                                  (link.back - step + 6) % 4};
                if (taken_.count(key(next.x, next.y)) == 0 && goes_on(here, step, next)) put(next);
            }
        }
        return grid;
    }

private:
    // `turn`: which of the corner's own directions is the grid's x.
    struct Placed {
        int index, x, y, turn;
    };

    static std::int64_t key(int x, int y) {
        return (static_cast<std::int64_t>(x) * (std::int64_t{1} << 32)) ^
               static_cast<std::uint32_t>(y);
    }

    // Whether a step leads about where the grid's other steps beside and before it say.
    bool goes_on(const Placed& here, int step, const Placed& next) const {
        const auto [dx, dy] = STEPS[step];
        const Place from = saddles_[here.index].pixel, to = saddles_[next.index].pixel;
        const std::array<std::array<int, 2>, 3> others = {
            {{here.x - dx, here.y - dy}, {here.x + dy, here.y + dx}, {here.x - dy, here.y - dx}}};
        for (const auto& [x, y] : others) {
            const auto behind = taken_.find(key(x, y)), ahead = taken_.find(key(x + dx, y + dy));
            if (behind == taken_.end() || ahead == taken_.end()) continue;
            const float other_x = ahead->second.x - behind->second.x,
                        other_y = ahead->second.y - behind->second.y;
            if (length(to.x - from.x - other_x, to.y - from.y - other_y) >
                MOST_CHANGED * length(other_x, other_y))
                return false;
        }
        return true;
    }

    const std::vector<Saddle>& saddles_;
    const std::vector<Links>& links_;
    std::vector<char> seen_;
    std::unordered_map<std::int64_t, Place> taken_;
};

}  // namespace

Extent Extent::of(const Grid& grid) {
    if (grid.empty()) return {0, 0, -1, -1};
    Extent extent{grid[0].x, grid[0].y, grid[0].x, grid[0].y};
    for (const GridCorner& corner : grid) {
        extent.left = std::min(extent.left, corner.x), extent.top = std::min(extent.top, corner.y);
        extent.right = std::max(extent.right, corner.x);
        extent.bottom = std::max(extent.bottom, corner.y);
    }
    return extent;
}

std::vector<Grid> find_grids(const std::vector<Saddle>& saddles) {
    std::vector<Grid> grids;
    if (saddles.size() < LEAST_CORNERS) return grids;
    const std::vector<Links> links = mutual_links(saddles);
    const auto linked = [&](int corner) {
        return std::count_if(links[corner].begin(), links[corner].end(),
                             [](const Link& link) { return link.to >= 0; });
    };
    Walk walk(saddles, links);
    // Those with the most neighbours first; a grid has a corner with two.
    for (int count = 4; count >= 2; --count) {
        for (int seed = 0; seed < static_cast<int>(saddles.size()); ++seed) {
            if (walk.has_seen(seed) || linked(seed) != count) continue;
            Grid grid = walk.from(seed);
            if (grid.size() >= LEAST_CORNERS) grids.push_back(std::move(grid));
        }
    }
    std::stable_sort(grids.begin(), grids.end(),
                     [](const Grid& a, const Grid& b) { return a.size() > b.size(); });
    return grids;
}

}  // namespace trigpoint
