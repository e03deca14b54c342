#include "registration/planar_fit.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

namespace trigpoint {
namespace {

constexpr int NEWTON_STEPS = 4;
// After a step of such a share the next one is of its square.
constexpr double SETTLED = 1e-5;
// Of the quadratic's slope, how much at least is left with the second coefficient.
constexpr double LEAST_SLOPE = 0.1;
// So many corners to every number of a bend, or it would take up wild corners too.
constexpr int CORNERS_A_TERM = 4, MOST_DEGREE = 4;
// Beyond the corners, of half their extent, a bend goes on so far: the squares about a small board.
constexpr double BEYOND = 1.5;

using Terms = Eigen::Matrix<double, Bend::MOST_TERMS, 1>;

int count_of(int degree) { return (degree + 1) * (degree + 2) / 2 - 3; }

// Products of Legendre polynomials of degree 2 and more at a place of -1 to 1.
Terms terms_at(const Eigen::Vector2d& place) {
    std::array<Eigen::Vector2d, MOST_DEGREE + 1> lines;
    lines[0].setOnes();
    lines[1] = place;
    for (int n = 1; n < MOST_DEGREE; ++n)
        lines[n + 1] = ((2 * n + 1) * place.cwiseProduct(lines[n]) - n * lines[n - 1]) / (n + 1);
    Terms terms;
    int term = 0;
    for (int n = 2; n <= MOST_DEGREE; ++n) {
        for (int i = 0; i <= n; ++i) terms(term++) = lines[i].x() * lines[n - i].y();
    }
    return terms;
}

}  // namespace

Eigen::Vector2d Bend::at(const Eigen::Vector2d& point) const {
    if (degree == 0) return Eigen::Vector2d::Zero();
    const Eigen::Vector2d place =
        (point - middle).cwiseQuotient(half).cwiseMax(-BEYOND).cwiseMin(BEYOND);
    return values.transpose() * terms_at(place);
}

Bend Bend::of(const PointsIn& points, const PointsIn& left) {
    Bend bend;
    int degree = MOST_DEGREE;
    while (degree >= 2 && count_of(degree) * CORNERS_A_TERM > points.rows()) --degree;
    if (degree < 2) return bend;
    const Eigen::Vector2d low = points.colwise().minCoeff(), high = points.colwise().maxCoeff();
    if (!((high - low).minCoeff() > 0)) return bend;
    bend.middle = 0.5 * (low + high), bend.half = 0.5 * (high - low);
    const int count = count_of(degree);
    Eigen::Matrix<double, MOST_TERMS, MOST_TERMS> normal;
    Eigen::Matrix<double, MOST_TERMS, 2> right;
    normal.setZero(), right.setZero();
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
        const Eigen::Vector2d place =
            (points.row(i).transpose() - bend.middle).cwiseQuotient(bend.half);
        const Terms terms = terms_at(place);
        normal += terms * terms.transpose();
        right += terms * left.row(i);
    }
    // Places without one of the terms, as on two lines, leave it out.
    normal.diagonal().array() += 1e-9;
    bend.values.topRows(count) =
        normal.topLeftCorner(count, count).ldlt().solve(right.topRows(count));
    bend.degree = bend.values.allFinite() ? degree : 0;
    return bend;
}

PlanarFit PlanarFit::of_size(double width, double height) {
    PlanarFit fit;
    fit.centre = {(width - 1) / 2, (height - 1) / 2};
    fit.scale = std::max(std::hypot(width, height) / 2, 1e-9);
    return fit;
}

PlanarFit PlanarFit::unpacked(const double* numbers) {
    PlanarFit fit;
    for (int i = 0; i < 9; ++i) fit.homography(i / 3, i % 3) = numbers[i];
    fit.radial = {numbers[9], numbers[10]};
    fit.centre = {numbers[11], numbers[12]};
    fit.scale = numbers[13];
    fit.aside = {numbers[14], numbers[15]};
    fit.bend.middle = {numbers[16], numbers[17]};
    fit.bend.half = {numbers[18], numbers[19]};
    const double degree = numbers[20];
    fit.bend.degree = degree >= 2 && degree <= MOST_DEGREE ? static_cast<int>(degree) : 0;
    for (int i = 0; i < 2 * count_of(fit.bend.degree); ++i)
        fit.bend.values(i / 2, i % 2) = numbers[21 + i];
    return fit;
}

void PlanarFit::pack(double* numbers) const {
    const double scaling = 1 / homography.leftCols<2>().norm();
    for (int i = 0; i < 9; ++i) numbers[i] = scaling * homography(i / 3, i % 3);
    numbers[9] = radial.x(), numbers[10] = radial.y();
    numbers[11] = centre.x(), numbers[12] = centre.y();
    numbers[13] = scale;
    numbers[14] = aside.x(), numbers[15] = aside.y();
    numbers[16] = bend.middle.x(), numbers[17] = bend.middle.y();
    numbers[18] = bend.half.x(), numbers[19] = bend.half.y();
    numbers[20] = bend.degree;
    for (int i = 0; i < 2 * Bend::MOST_TERMS; ++i) numbers[21 + i] = bend.values(i / 2, i % 2);
}

Eigen::Vector2d PlanarFit::straight(const Eigen::Vector2d& point) const {
    const Eigen::Vector3d ray = homography * point.homogeneous();
    return centre + scale * (share_of(ray, radial) * ray.head<2>() + aside);
}

Eigen::Vector2d PlanarFit::project(const Eigen::Vector2d& point) const {
    return bend.degree == 0 ? straight(point) : Eigen::Vector2d(straight(point) + bend.at(point));
}

Unprojection::Unprojection(const PlanarFit& fit, const Eigen::Matrix3d& then)
    : fit_(&fit), inverse_(fit.homography.inverse()), moved_(then * inverse_) {}

Eigen::Vector3d Unprojection::ray(const Eigen::Vector2d& pixel) const {
    const Eigen::Vector2d flat = (pixel - fit_->centre) / fit_->scale - fit_->aside;
    const double squared = flat.squaredNorm();
    return {flat.x(), flat.y(), 1 + squared * (fit_->radial.x() + squared * fit_->radial.y())};
}

Eigen::Vector2d Unprojection::through(const Eigen::Matrix3d& map, const Eigen::Vector3d& ray) {
    const Eigen::Vector3d moved = map * ray;
    // Of what lies on the horizon, something far away.
    return moved.head<2>() / (moved.z() == 0 ? 1e-9 : moved.z());
}

Eigen::Vector2d Unprojection::operator()(const Eigen::Vector2d& pixel) const {
    if (fit_->bend.degree == 0) return through(moved_, ray(pixel));
    // The bend is small and smooth: where it moves a point to is where it would move that too.
    const Eigen::Vector2d about = through(inverse_, ray(pixel));
    return through(moved_, ray(pixel - fit_->bend.at(about)));
}

double share_of(const Eigen::Vector3d& ray, const Eigen::Vector2d& radial) {
    const double squared = ray.head<2>().squaredNorm(), depth = ray.z();
    const double first = radial.x() * squared, second = radial.y() * squared * squared;
    const double root = std::sqrt(std::max(depth * depth - 4 * first, 0.0));
    // With the first coefficient alone it is a quadratic equation.
    double share = 2 / std::max(depth + root, HORIZON);
    if (radial.y() == 0) return share;
    const double steepest = -std::max(LEAST_SLOPE * root, HORIZON);
    for (int step = 0; step < NEWTON_STEPS; ++step) {
        const double square = share * share, lens = second * square;
        const double error = 1 + square * (first + lens) - depth * share;
        const double slope = std::min(share * (2 * first + 4 * lens) - depth, steepest);
        const double change = std::clamp(-error / slope, -0.5 * share, share);
        share += change;
        if (std::abs(change) < SETTLED * share) break;
    }
    return share;
}

}  // namespace trigpoint
