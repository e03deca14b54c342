#include "registration/plane_fitting.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace trigpoint {
namespace {

constexpr double RADIAL_PRIOR = 0.5;    // of each coefficient, at the corner of the picture
constexpr double PRIOR_SIGMA_PX = 0.3;  // what one residual is worth against that prior
constexpr int ITERATIONS = 12;
// Numbers of a homography, and of that with a lens and its centre; the centre is held so firmly
// that it takes up no scatter.
constexpr int PLANE = 8, ALL = 12, LENS_FREEDOM = 10;
// After a step that moves every corner by less, the next one moves none by a thousandth of a pixel:
// of a homography alone, and with a lens.
constexpr double SMALL_STEP_PX = 0.1, SMALL_LENS_STEP_PX = 0.02;
constexpr double SMALL_GAIN = 1e-4, LEAST_DAMPING = 1e-7, DAMPING_STEP = 10.0;
constexpr double TINY = 1e-12, RUNAWAY = 1e4;
// The centre of a lens is not quite the picture's. Each half diagonal that it lies aside counts
// like a residual of so many pixels: in a picture of 640 x 480, a sixtieth of a pixel for each
// pixel, which is little against what it explains of a wide lens, and much against a sharp noise.
constexpr double CENTRE_WEIGHT_PX = 6.7;
// 180 degrees in a circle of 0.4 of the picture's diagonal.
constexpr double MOST_RADIAL = 6.0;

using Numbers = Eigen::Matrix<double, ALL, 1>;
using Normal = Eigen::Matrix<double, ALL, ALL>;

// What is fitted: the first eight of a homography, its last one held at 1, the lens's radial
// numbers, and its centre.
Numbers numbers_of(const Eigen::Matrix3d& homography, const PlanarFit& fit) {
    Numbers numbers;
    for (int i = 0; i < PLANE; ++i) numbers(i) = homography(i / 3, i % 3) / homography(2, 2);
    numbers.segment<2>(8) = fit.radial;
    numbers.tail<2>() = fit.aside;
    return numbers;
}

Eigen::Matrix3d homography_of(const Numbers& numbers) {
    Eigen::Matrix3d homography;
    for (int i = 0; i < PLANE; ++i) homography(i / 3, i % 3) = numbers(i);
    homography(2, 2) = 1;
    return homography;
}

// Where a point comes to by the numbers, taken from the lens's centre, and its derivative by them.
struct Linearised {
    Eigen::Vector2d place;
    Eigen::Matrix<double, 2, ALL> jacobian;
};

Linearised linearised(const Numbers& numbers, const Eigen::Matrix3d& homography,
                      const Eigen::Vector3d& point) {
    const Eigen::Vector2d radial = numbers.segment<2>(8);
    const Eigen::Vector3d ray = homography * point;
    const double share = share_of(ray, radial);
    const double squared = ray.head<2>().squaredNorm(), square = share * share;
    // How the share changes with the ray and with the lens, by its own equation.
    const double lens = squared * square;
    const double slope =
        std::min(share * squared * (2 * radial.x() + 4 * radial.y() * lens) - ray.z(), -HORIZON);
    const double outward = -2 * square * (radial.x() + 2 * radial.y() * lens) / slope;
    Linearised made;
    made.place = share * ray.head<2>();
    for (int axis = 0; axis < 2; ++axis) {
        const double place = ray(axis);
        Eigen::Vector3d by_ray(place * outward * ray.x(), place * outward * ray.y(),
                               place * share / slope);
        by_ray(axis) += share;
        auto row = made.jacobian.row(axis);
        for (int i = 0; i < PLANE; ++i) row(i) = by_ray(i / 3) * point(i % 3);
        row(8) = -place * lens / slope;
        row(9) = row(8) * lens;
        row(10) = axis == 0, row(11) = axis == 1;
    }
    return made;
}

// What a fit is made to: points that are moved to mean 0 and a spread of 1, and pixels in units of
// the scale, taken from the centre.
class Problem {
public:
    Problem(const PointsIn& points, const PointsIn& pixels, const PlanarFit& fit, bool has_bend)
        : points_(points), pixels_(pixels), fit_(fit), has_bend_(has_bend) {
        const Eigen::RowVector2d mean = points.colwise().mean();
        const double spread =
            std::sqrt((points.rowwise() - mean).squaredNorm() / (2.0 * double(points.rows())));
        const double to_one = 1 / std::max(spread, 1e-12);
        normalising_ << to_one, 0, -to_one * mean.x(), 0, to_one, -to_one * mean.y(), 0, 0, 1;
    }

    Eigen::Index count() const { return points_.rows(); }
    const Eigen::Matrix3d& normalising() const { return normalising_; }
    Eigen::Vector3d point(Eigen::Index i) const {
        return normalising_ * points_.row(i).transpose().homogeneous();
    }
    Eigen::Vector2d target(Eigen::Index i) const {
        Eigen::Vector2d pixel = pixels_.row(i);
        if (has_bend_) pixel -= fit_.bend.at(points_.row(i));
        return (pixel - fit_.centre) / fit_.scale;
    }

private:
    const PointsIn& points_;
    const PointsIn& pixels_;
    const PlanarFit& fit_;
    bool has_bend_;
    Eigen::Matrix3d normalising_;
};

// The homography of least algebraic error (Hartley 1997; the points are normalised already, and the
// pixels nearly) whose last number is 1, which none in front of the camera lacks: the points lie
// about 0. None where it is not finite.
std::optional<Eigen::Matrix3d> direct_homography(const Problem& problem) {
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    for (Eigen::Index i = 0; i < problem.count(); ++i) mean += problem.target(i);
    mean /= static_cast<double>(problem.count());
    double squares = 0;
    for (Eigen::Index i = 0; i < problem.count(); ++i)
        squares += (problem.target(i) - mean).squaredNorm();
    const double spread =
        std::max(std::sqrt(squares / (2.0 * static_cast<double>(problem.count()))), 1e-12);
    Eigen::Matrix<double, PLANE, PLANE> normal = Eigen::Matrix<double, PLANE, PLANE>::Zero();
    Eigen::Matrix<double, PLANE, 1> right = Eigen::Matrix<double, PLANE, 1>::Zero();
    for (Eigen::Index i = 0; i < problem.count(); ++i) {
        const Eigen::Vector3d point = problem.point(i);
        const Eigen::Vector2d target = (problem.target(i) - mean) / spread;
        Eigen::Matrix<double, 2, PLANE> rows = Eigen::Matrix<double, 2, PLANE>::Zero();
        rows.block<1, 3>(0, 0) = point.transpose();
        rows.block<1, 3>(1, 3) = point.transpose();
        rows.rightCols<2>() = -target * point.head<2>().transpose();
        normal += rows.transpose().lazyProduct(rows);
        right += rows.transpose() * target;
    }
    const Eigen::Matrix<double, PLANE, 1> least = normal.ldlt().solve(right);
    Eigen::Matrix3d homography, back;
    for (int i = 0; i < PLANE; ++i) homography(i / 3, i % 3) = least(i);
    homography(2, 2) = 1;
    back << spread, 0, mean.x(), 0, spread, mean.y(), 0, 0, 1;
    homography = back * homography;
    if (!homography.allFinite()) return std::nullopt;
    return homography;
}

// Where a fit has got to: its numbers, its cost, and its normal equations.
struct State {
    Numbers numbers, right;
    Normal normal;
    double cost = 0, steepest = 0;

    State(const Problem& problem, const Numbers& at, const Numbers& weights)
        : numbers(at), right(Numbers::Zero()), normal(Normal::Zero()) {
        const Eigen::Matrix3d homography = homography_of(numbers);
        const Eigen::Vector2d aside = numbers.tail<2>();
        for (Eigen::Index i = 0; i < problem.count(); ++i) {
            const Linearised made = linearised(numbers, homography, problem.point(i));
            const Eigen::Vector2d error = problem.target(i) - made.place - aside;
            normal += made.jacobian.transpose().lazyProduct(made.jacobian);
            right += made.jacobian.transpose() * error;
            cost += error.squaredNorm();
            steepest = std::max(steepest, made.jacobian.cwiseAbs().maxCoeff());
        }
        cost += weights.dot(numbers.cwiseProduct(numbers));
        right -= weights.cwiseProduct(numbers);
        normal.diagonal() += weights;
    }

    // The step of the first `count` numbers; none where the fit has run away.
    std::optional<Numbers> step(int count, double damping) const {
        if (!(steepest < RUNAWAY)) return std::nullopt;
        Normal damped = normal;
        damped.diagonal() *= 1 + damping;
        damped.diagonal().array() += TINY;
        using Part = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, ALL, ALL>;
        const Part part = damped.topLeftCorner(count, count);
        const Eigen::LLT<Part> solver(part);
        if (solver.info() != Eigen::Success) return std::nullopt;
        Numbers step = Numbers::Zero();
        step.head(count) = solver.solve(right.head(count));
        if (!step.allFinite()) return std::nullopt;
        return step;
    }

    Numbers moved(const Numbers& step) const {
        Numbers there = numbers + step;
        there.segment<2>(8) = there.segment<2>(8).cwiseMax(-MOST_RADIAL).cwiseMin(MOST_RADIAL);
        return there;
    }
};

// The farthest that a step moves any corner, to first order, in units of the scale.
double reach_of(const Problem& problem, const State& now, const Numbers& step) {
    const Eigen::Matrix3d homography = homography_of(now.numbers);
    double farthest = 0;
    for (Eigen::Index i = 0; i < problem.count(); ++i) {
        const Linearised made = linearised(now.numbers, homography, problem.point(i));
        farthest = std::max(farthest, (made.jacobian * step).cwiseAbs().maxCoeff());
    }
    return farthest;
}

// Levenberg-Marquardt over the homography (its last number held at 1: the points lie about 0), the
// radial coefficients and the centre of the lens. None where it runs away, since the points lie on
// no plane in front of the camera.
std::optional<Numbers> refined(const Problem& problem, const PlanarFit& fit, bool is_lens_free) {
    if (!(std::abs(fit.homography(2, 2)) > 1e-9)) return std::nullopt;
    Numbers weights = Numbers::Zero();
    if (is_lens_free) {
        const double radial = PRIOR_SIGMA_PX / fit.scale / RADIAL_PRIOR,
                     centre = CENTRE_WEIGHT_PX / fit.scale;
        weights.segment<2>(8).setConstant(radial * radial);
        weights.tail<2>().setConstant(centre * centre);
    }
    const double small = (is_lens_free ? SMALL_LENS_STEP_PX : SMALL_STEP_PX) / fit.scale;
    const int count = is_lens_free ? ALL : PLANE;
    State now(problem, numbers_of(fit.homography, fit), weights);
    double damping = LEAST_DAMPING;
    for (int round = 0; round < ITERATIONS; ++round) {
        std::optional<Numbers> step = now.step(count, damping);
        if (!step) return std::nullopt;
        if (reach_of(problem, now, *step) < small) return now.moved(*step);
        State there(problem, now.moved(*step), weights);
        if (is_lens_free && !(there.cost <= now.cost)) {
            // The homography must follow the lens further than their derivatives say.
            step = there.step(PLANE, LEAST_DAMPING);
            if (step) there = State(problem, there.moved(*step), weights);
        }
        if (!(there.cost <= now.cost)) {
            damping *= DAMPING_STEP;
            continue;
        }
        const double gained = now.cost - there.cost;
        const bool is_done = gained < SMALL_GAIN * now.cost;
        now = there;
        damping = std::max(LEAST_DAMPING, damping / DAMPING_STEP);
        if (is_done) break;
    }
    return now.numbers;
}

double farthest_residual(const PlanarFit& fit, const PointsIn& points, const PointsIn& pixels) {
    double farthest = 0;
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        farthest = std::max(farthest, fit.residual(points.row(i), pixels.row(i)));
    return farthest;
}

}  // namespace

std::optional<PlanarFit> fit_plane(const PointsIn& points, const PointsIn& pixels,
                                   const PlanarFit& start, bool has_start, bool has_lens) {
    if (points.rows() < 4 || !points.allFinite() || !pixels.allFinite()) return std::nullopt;
    const bool has_bend = has_start && !has_lens && start.bend.degree > 0;
    const Problem problem(points, pixels, start, has_bend);
    PlanarFit fit = start;
    if (has_start) {
        fit.homography = start.homography * problem.normalising().inverse();
    } else {
        const auto direct = direct_homography(problem);
        if (!direct) return std::nullopt;
        fit = PlanarFit{};
        fit.homography = *direct;
        fit.centre = start.centre, fit.scale = start.scale;
    }
    const auto numbers = refined(problem, fit, has_lens && points.rows() > 4);
    if (!numbers) return std::nullopt;
    fit.homography = homography_of(*numbers) * problem.normalising();
    fit.homography /= fit.homography.norm();
    fit.radial = numbers->segment<2>(8), fit.aside = numbers->tail<2>();
    if (!has_bend) fit.bend = Bend{};
    if (!fit.homography.allFinite()) return std::nullopt;
    return fit;
}

std::optional<PlanarFit> settled_fit(const PointsIn& points, const PointsIn& pixels,
                                     const PlanarFit& start, bool has_start, double enough_px) {
    auto fit = fit_plane(points, pixels, start, has_start, false);
    if (!fit || farthest_residual(*fit, points, pixels) <= enough_px) return fit;
    fit = fit_plane(points, pixels, *fit, true, true);
    if (!fit || farthest_residual(*fit, points, pixels) <= enough_px) return fit;
    Points left(points.rows(), 2);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
        left.row(i) = pixels.row(i) - fit->project(points.row(i)).transpose();
    fit->bend = Bend::of(points, left);
    return fit;
}

Scatter scatter_about(const PlanarFit& fit, const PointsIn& points, const PointsIn& pixels) {
    const int freedom = 2 * static_cast<int>(points.rows()) - LENS_FREEDOM;
    if (freedom <= 0) return {};
    const Problem problem(points, pixels, fit, false);
    const Eigen::Matrix3d homography = fit.homography * problem.normalising().inverse();
    // Two more residuals hold the centre of the lens.
    Numbers weights = Numbers::Zero();
    const double weight = CENTRE_WEIGHT_PX / fit.scale;
    weights.tail<2>().setConstant(weight * weight);
    const State state(problem, numbers_of(homography, fit), weights);
    const Numbers size = state.normal.diagonal().cwiseMax(1e-300).cwiseSqrt();
    const Normal scaled =
        size.cwiseInverse().asDiagonal() * state.normal * size.cwiseInverse().asDiagonal();
    const Numbers right = state.right.cwiseQuotient(size);
    const double explained = right.dot(scaled.ldlt().solve(right));
    const double left =
        std::isfinite(explained) ? std::max(0.0, state.cost - explained) : state.cost;
    return {fit.scale * fit.scale * left, freedom};
}

}  // namespace trigpoint
