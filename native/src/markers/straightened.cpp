#include <algorithm>
#include <cmath>

#include "markers/quads.hpp"

namespace trigpoint {
namespace {

// Where along a side its edge is looked for, and how far across it, pixels.
constexpr int ALONG = 7, ACROSS = 9;
constexpr double FIRST_ALONG = 0.2, ALONG_STEP = 0.1, FIRST_ACROSS = -2.0, ACROSS_STEP = 0.5;
constexpr double MOST_MENDED_PX = 4.0, MOST_MENDED_SHARE = 0.3;

// How far outwards the line along a side's edge begins and ends.
struct Line {
    Eigen::Vector2d begin, end;
};

Line edge_line(const Grey& grey, const Eigen::Vector2d& from, const Eigen::Vector2d& to) {
    const Eigen::Vector2d along = to - from;
    const double length = std::max(along.norm(), 1e-9);
    const Eigen::Vector2d outward = Eigen::Vector2d(along.y(), -along.x()) / length;
    std::array<double, ALONG> edge, weight;
    std::array<float, ALONG * ACROSS> xs, ys, values;
    for (int i = 0; i < ALONG; ++i) {
        const Eigen::Vector2d begin = from + (FIRST_ALONG + ALONG_STEP * i) * along;
        for (int j = 0; j < ACROSS; ++j) {
            const Eigen::Vector2d at = begin + (FIRST_ACROSS + ACROSS_STEP * j) * outward;
            xs[i * ACROSS + j] = static_cast<float>(at.x());
            ys[i * ACROSS + j] = static_cast<float>(at.y());
        }
    }
    sample(grey, xs.data(), ys.data(), ALONG * ACROSS, values.data());
    double total = 0, middle = 0, mean = 0;
    for (int i = 0; i < ALONG; ++i) {
        const double share = FIRST_ALONG + ALONG_STEP * i;
        double before = 0, rises = 0, moment = 0;
        for (int j = 0; j < ACROSS; ++j) {
            const double value = values[i * ACROSS + j];
            if (j > 0) {
                const double rise = std::max(value - before, 0.0);
                rises += rise * rise;
                moment += rise * rise * (FIRST_ACROSS + ACROSS_STEP * (j - 0.5));
            }
            before = value;
        }
        edge[i] = moment / std::max(rises, 1e-9), weight[i] = rises;
        total += rises, middle += rises * share, mean += rises * edge[i];
    }
    total = std::max(total, 1e-9), middle /= total, mean /= total;
    double spread = 0, slope = 0;
    for (int i = 0; i < ALONG; ++i) {
        const double apart = FIRST_ALONG + ALONG_STEP * i - middle;
        spread += weight[i] * apart * apart, slope += weight[i] * apart * edge[i];
    }
    slope /= std::max(spread, 1e-9);
    return {from + (mean - slope * middle) * outward, to + (mean + slope * (1 - middle)) * outward};
}

}  // namespace

Quad straightened(const Grey& grey, const Quad& quad) {
    std::array<Line, 4> sides;
    for (int k = 0; k < 4; ++k) sides[k] = edge_line(grey, quad[k], quad[(k + 1) % 4]);
    Quad better = quad;
    for (int k = 0; k < 4; ++k) {
        const Line &before = sides[(k + 3) % 4], &after = sides[k];
        const Eigen::Vector2d first = before.end - before.begin, second = after.end - after.begin,
                              apart = after.begin - before.begin;
        const double turn = first.x() * second.y() - first.y() * second.x();
        const Eigen::Vector2d corner =
            std::abs(turn) < 1e-6
                ? after.begin
                : Eigen::Vector2d(before.begin +
                                  (apart.x() * second.y() - apart.y() * second.x()) / turn * first);
        const double length = (quad[(k + 1) % 4] - quad[k]).norm();
        if ((corner - quad[k]).norm() <= std::min(MOST_MENDED_PX, MOST_MENDED_SHARE * length))
            better[k] = corner;
    }
    return better;
}

}  // namespace trigpoint
