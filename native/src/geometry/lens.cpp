#include "geometry/lens.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "border.hpp"

namespace trigpoint {

namespace {

// Of Newton's method.
constexpr int MOST_ROUNDS = 20;
constexpr double CONVERGED = 1e-12, WRONG = 1e-9;
constexpr double RIGHT_ANGLE = 1.5707963267948966;

}  // namespace

Lens::Lens(const double* parameters, Eigen::Index count) : coefficients_(count - 4) {
    switch (coefficients_) {
        case 5:
            model_ = Model::PLUMB_BOB;
            break;
        case 8:
            model_ = Model::RATIONAL_POLYNOMIAL;
            break;
        case 4:
            model_ = Model::EQUIDISTANT;
            break;
        default:
            throw std::invalid_argument("no lens model has so many parameters");
    }
    focal_ = {parameters[0], parameters[1]};
    centre_ = {parameters[2], parameters[3]};
    std::copy(parameters + 4, parameters + count, k_);
}

Eigen::Vector2d Lens::project(const Eigen::Vector3d& point,
                              Eigen::Matrix<double, 2, 3>& by_point) const {
    const double inverse = 1 / point.z();
    const Eigen::Vector2d normalised = point.head<2>() * inverse;
    Eigen::Matrix2d by;
    const Eigen::Vector2d bent =
        model_ == Model::EQUIDISTANT ? equidistant(normalised, by) : polynomial(normalised, by);
    by_point.leftCols<2>() = (focal_ * inverse).asDiagonal() * by;
    by_point.col(2) = -(by_point.leftCols<2>() * normalised);
    return bent.cwiseProduct(focal_) + centre_;
}

Eigen::Vector2d Lens::direction(const Eigen::Vector2d& pixel) const {
    const Eigen::Vector2d none =
        Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    const Eigen::Vector2d target = (pixel - centre_).cwiseQuotient(focal_);
    if (model_ == Model::EQUIDISTANT) {
        const double radius = target.norm();
        double angle = radius, error = 1;
        for (int round = 0; round <= MOST_ROUNDS; ++round) {
            const double s = angle * angle;
            error = angle * (1 + s * (k_[0] + s * (k_[1] + s * (k_[2] + s * k_[3])))) - radius;
            if (round == MOST_ROUNDS || std::abs(error) < CONVERGED) break;
            angle -=
                error / (1 + s * (3 * k_[0] + s * (5 * k_[1] + s * (7 * k_[2] + s * 9 * k_[3]))));
        }
        if (!(std::abs(error) < WRONG && angle >= 0 && angle < RIGHT_ANGLE)) return none;
        return radius > 1e-12 ? Eigen::Vector2d(target * (std::tan(angle) / radius)) : target;
    }
    Eigen::Vector2d guess = target;
    Eigen::Matrix2d by;
    for (int round = 0; round < MOST_ROUNDS; ++round) {
        const Eigen::Vector2d error = target - polynomial(guess, by);
        if (error.cwiseAbs().maxCoeff() < CONVERGED) break;
        guess += by.inverse() * error;
    }
    return (polynomial(guess, by) - target).norm() < WRONG ? guess : none;
}

void Lens::by_parameters(const Eigen::Vector3d& point, Eigen::Ref<Eigen::MatrixXd> by) const {
    const Eigen::Vector2d n = point.head<2>() / point.z();
    by.setZero();
    auto by_k = by.rightCols(coefficients_);
    Eigen::Matrix2d by_direction;
    Eigen::Vector2d bent;
    if (model_ == Model::EQUIDISTANT) {
        bent = equidistant(n, by_direction);
        const double radius = n.norm(), angle = std::atan(radius);
        const Eigen::Vector2d unit = radius > 1e-9 ? Eigen::Vector2d(n / radius) : n;
        for (int power = 3; power < 10; power += 2)
            by_k.col(power / 2 - 1) = unit * std::pow(angle, power);
    } else {
        bent = polynomial(n, by_direction);
        const double x = n.x(), y = n.y(), r2 = x * x + y * y, r4 = r2 * r2, r6 = r4 * r2;
        const double below = 1 + k_[5] * r2 + k_[6] * r4 + k_[7] * r6;
        const double radial = (1 + k_[0] * r2 + k_[1] * r4 + k_[4] * r6) / below;
        by_k.col(0) = n * (r2 / below);
        by_k.col(1) = n * (r4 / below);
        by_k.col(2) << 2 * x * y, r2 + 2 * y * y;
        by_k.col(3) << r2 + 2 * x * x, 2 * x * y;
        by_k.col(4) = n * (r6 / below);
        if (model_ == Model::RATIONAL_POLYNOMIAL) {
            by_k.col(5) = -n * (radial * r2 / below);
            by_k.col(6) = -n * (radial * r4 / below);
            by_k.col(7) = -n * (radial * r6 / below);
        }
    }
    by_k = focal_.asDiagonal() * by_k;
    by(0, 0) = bent.x();
    by(1, 1) = bent.y();
    by(0, 2) = by(1, 3) = 1;
}

Eigen::Vector2d Lens::polynomial(const Eigen::Vector2d& normalised, Eigen::Matrix2d& by) const {
    const auto [k1, k2, p1, p2, k3, k4, k5, k6] = k_;
    const double x = normalised.x(), y = normalised.y(), r2 = x * x + y * y;
    double radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
    double slope = k1 + r2 * (2 * k2 + r2 * (3 * k3));  // of radial by r²
    if (model_ == Model::RATIONAL_POLYNOMIAL) {
        const double below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6));
        radial /= below;
        slope = (slope - radial * (k4 + r2 * (2 * k5 + r2 * (3 * k6)))) / below;
    }
    const double along = 2 * p1 * y + 2 * p2 * x;
    by(0, 0) = radial + 2 * slope * x * x + 2 * p1 * y + 6 * p2 * x;
    by(0, 1) = by(1, 0) = 2 * slope * x * y + 2 * p1 * x + 2 * p2 * y;
    by(1, 1) = radial + 2 * slope * y * y + 6 * p1 * y + 2 * p2 * x;
    return {x * (radial + along) + p2 * r2, y * (radial + along) + p1 * r2};
}

Eigen::Vector2d Lens::equidistant(const Eigen::Vector2d& normalised, Eigen::Matrix2d& by) const {
    const double radius = normalised.norm();
    if (!(radius > 1e-9)) {
        by.setIdentity();
        return normalised;
    }
    const double angle = std::atan(radius), s = angle * angle;
    const double bent = angle * (1 + s * (k_[0] + s * (k_[1] + s * (k_[2] + s * k_[3]))));
    const double slope = 1 + s * (3 * k_[0] + s * (5 * k_[1] + s * (7 * k_[2] + s * 9 * k_[3])));
    const double scale = bent / radius;
    const Eigen::Vector2d unit = normalised / radius;
    by = (slope / (1 + radius * radius) - scale) * unit * unit.transpose();
    by.diagonal().array() += scale;
    return normalised * scale;
}

}  // namespace trigpoint

using namespace trigpoint;

namespace {

using Eigen::Index;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Lens lens_of(const Argument& given) { return {given.array.as<double>(), given.array.shape[0]}; }

}  // namespace

// (lens (p,), points (n, 3), pixels (n, 2), by the points (n or 0, 6), by the parameters (n or 0,
// 2 p)): 0; derivatives that have no rows are not wanted.
TRIGPOINT_KERNEL(tp_lens_projected) {
    const Lens lens = lens_of(arguments[0]);
    const auto points = arguments[1].array.rows<3>();
    auto pixels = arguments[2].array.rows<2>();
    auto by_points = arguments[3].array.rows<6>();
    const Index count = points.rows(), by_count = arguments[4].array.shape[0];
    if ((by_points.rows() != 0 && by_points.rows() != count) ||
        (by_count != 0 &&
         (by_count != count || arguments[4].array.shape[1] != 2 * lens.parameters())))
        throw std::invalid_argument("derivatives of other points");
    Eigen::Matrix<double, 2, 3> by_point;
    Eigen::MatrixXd by(2, lens.parameters());
    double* by_parameters = arguments[4].array.as<double>();
    for (Index n = 0; n < count; ++n) {
        const Eigen::Vector3d point = points.row(n);
        pixels.row(n) = lens.project(point, by_point);
        if (by_points.rows() > 0) by_points.row(n) << by_point.row(0), by_point.row(1);
        if (by_count == 0) continue;
        lens.by_parameters(point, by);
        Eigen::Map<RowMajor>(by_parameters + by.size() * n, 2, by.cols()) = by;
    }
    return 0;
}

// (lens (p,), points (n, 3), limits (4,): the picture's width and height, how far from the axis the
// lens folds back, and the least distance from the middles of the outermost pixels; whether each is
// seen (n,)): 0.
TRIGPOINT_KERNEL(tp_lens_sees) {
    const Lens lens = lens_of(arguments[0]);
    const auto points = arguments[1].array.rows<3>();
    const Frame frame(arguments[2].array.as<double>());
    for (Index n = 0; n < points.rows(); ++n)
        arguments[3].array.as<bool>()[n] = frame.shows(lens, points.row(n));
    return 0;
}

// (lens (p,), pixels (n, 2), directions (n, 2)): 0; NaN where there is none.
TRIGPOINT_KERNEL(tp_lens_directions) {
    const Lens lens = lens_of(arguments[0]);
    const auto pixels = arguments[1].array.rows<2>();
    auto directions = arguments[2].array.rows<2>();
    for (Index n = 0; n < pixels.rows(); ++n) directions.row(n) = lens.direction(pixels.row(n));
    return 0;
}
