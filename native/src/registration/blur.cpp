#include "registration/blur.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace trigpoint {
namespace {

// As far as a drawing is softened at least; what is less is made up by second derivatives.
constexpr double LEAST_GAUSSIAN = 0.2;
constexpr double MOST_RESPONSE = 1.0;
// How far one change is trusted.
const Eigen::Vector4d MOST_CHANGE(1.0, 1.0, 1.0, 0.5);
// Of a kernel's shares, which together are 1, what the products of its even part and those of its
// odd part may leave: a tenth of a grey level in a hundred each.
constexpr double LEFT_OVER = 1e-3;
// Of a kernel, in its standard deviations.
constexpr double REACH_SIGMAS = 2.6;

// Closed form of a symmetric matrix's eigenvalues, rising, and its axes.
struct Principal {
    Eigen::Vector2d values;
    Eigen::Matrix2d axes;

    explicit Principal(const Eigen::Vector3d& v) {
        const double middle = (v(0) + v(1)) / 2, apart = (v(0) - v(1)) / 2;
        const double half = std::hypot(apart, v(2));
        values = {middle - half, middle + half};
        const double angle = 0.5 * std::atan2(v(2), apart);  // of the upper one's axis
        axes << -std::sin(angle), std::cos(angle), std::cos(angle), std::sin(angle);
    }
};

using Shares = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor,
                             2 * MOST_RADIUS + 1, 2 * MOST_RADIUS + 1>;

// Adds products of a row and a column to a kernel until its shares are those: by crosses of what is
// left, about the largest (Bebendorf 2000), which are even or odd where that is.
void add_crosses(Shares left, Kernel& kernel) {
    Eigen::Index y, x;
    const int most = static_cast<int>(kernel.across.size());
    while (left.cwiseAbs().sum() > LEFT_OVER && kernel.terms < most) {
        left.cwiseAbs().maxCoeff(&y, &x);
        const Shares row = left.row(y), column = left.col(x) / left(y, x);
        for (Eigen::Index i = 0; i < row.size(); ++i) {
            kernel.across[kernel.terms][i] = static_cast<float>(row(i));
            kernel.down[kernel.terms][i] = static_cast<float>(column(i));
        }
        left -= column * row;
        ++kernel.terms;
    }
}

}  // namespace

Blur Blur::changed(const Eigen::Vector4d& change, double least) const {
    const Eigen::Vector4d step = change.cwiseMin(MOST_CHANGE).cwiseMax(-MOST_CHANGE);
    Blur better{variances + step.head<3>(),
                std::clamp(response + step(3), -MOST_RESPONSE, MOST_RESPONSE)};
    const Principal principal(better.variances);
    if (principal.values(0) < least || principal.values(1) > MOST_VARIANCE) {
        const Eigen::Vector2d values = principal.values.cwiseMax(least).cwiseMin(MOST_VARIANCE);
        const Eigen::Matrix2d matrix =
            principal.axes * values.asDiagonal() * principal.axes.transpose();
        better.variances = {matrix(0, 0), matrix(1, 1), matrix(0, 1)};
    }
    return better;
}

Blur Blur::softened(double variance) const {
    return {variances + Eigen::Vector3d(variance, variance, 0), response};
}

Kernel Blur::kernel(int step) const {
    const Principal principal(double(step * step) * variances);
    const double least = step * step * LEAST_GAUSSIAN;
    const double reach = REACH_SIGMAS * std::sqrt(std::max(principal.values(1), least));
    Kernel kernel;
    kernel.radius =
        std::clamp(static_cast<int>(std::ceil(std::min(reach, 1e3))), LEAST_RADIUS, MOST_RADIUS);
    kernel.terms = 0;
    const Eigen::Vector2d spread = principal.values.cwiseMax(least);
    const Eigen::Vector2d lacking = (principal.values - spread).cwiseQuotient(spread);
    const int taps = 2 * kernel.radius + 1;
    Shares shares(taps, taps);
    for (int y = 0; y < taps; ++y) {
        for (int x = 0; x < taps; ++x) {
            const Eigen::Vector2d along =
                principal.axes.transpose() * Eigen::Vector2d(x - kernel.radius, y - kernel.radius);
            const Eigen::Vector2d squares = along.cwiseAbs2().cwiseQuotient(spread);
            const double taken = 1 + 0.5 * (squares - Eigen::Vector2d::Ones()).dot(lacking);
            shares(y, x) = std::exp(-0.5 * squares.sum()) * taken;
        }
    }
    shares /= shares.sum();
    // What is even along both axes and what is odd, apart, so that no corner is pulled aside.
    const Shares mirrored = shares.rowwise().reverse();
    add_crosses(0.5 * (shares + mirrored), kernel);
    kernel.even = kernel.terms;
    add_crosses(0.5 * (shares - mirrored), kernel);
    return kernel;
}

}  // namespace trigpoint
