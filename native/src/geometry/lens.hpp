// A camera's intrinsics by the names of ROS, as `trigpoint.geometry.CameraModel` packs them.
#pragma once

#include <Eigen/Core>

namespace trigpoint {

// From a direction to a raw (distorted) pixel; formulae: OpenCV's documentation of `calib3d` and of
// `fisheye`.
class Lens {
public:
    // fx, fy, cx, cy and the distortion's coefficients, whose number says the model: 5 plumb_bob,
    // 8 rational_polynomial, 4 equidistant. Throws std::invalid_argument for any other.
    Lens(const double* parameters, Eigen::Index count);

    // fx, fy, cx, cy and the coefficients.
    Eigen::Index parameters() const { return 4 + coefficients_; }

    // The pixel of a point before the camera, and its derivative by the point.
    Eigen::Vector2d project(const Eigen::Vector3d& point,
                            Eigen::Matrix<double, 2, 3>& by_point) const;

    // The direction (x/z, y/z) that projects to a pixel; NaN where there is none.
    Eigen::Vector2d direction(const Eigen::Vector2d& pixel) const;

    // The derivative of the pixel of a point by the parameters, (2, parameters).
    void by_parameters(const Eigen::Vector3d& point, Eigen::Ref<Eigen::MatrixXd> by) const;

private:
    Eigen::Vector2d polynomial(const Eigen::Vector2d& normalised, Eigen::Matrix2d& by) const;
    Eigen::Vector2d equidistant(const Eigen::Vector2d& normalised, Eigen::Matrix2d& by) const;

    enum class Model { PLUMB_BOB, RATIONAL_POLYNOMIAL, EQUIDISTANT } model_;
    Eigen::Index coefficients_;
    Eigen::Vector2d focal_, centre_;
    double k_[8] = {};  // k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4
};

// What of a picture counts, and where a lens shows anything.
class Frame {
public:
    static constexpr double NEAREST = 1e-6;  // before the camera

    // The picture's width and height, how far from the axis the lens folds back, and the least
    // distance from the middles of the outermost pixels.
    explicit Frame(const double* limits)
        : low_(limits[3], limits[3]),
          high_(limits[0] - 1 - limits[3], limits[1] - 1 - limits[3]),
          fold_(limits[2]) {}

    // Whether a point of the optical frame is seen.
    bool shows(const Lens& lens, const Eigen::Vector3d& point) const {
        if (!(point.z() > NEAREST)) return false;
        Eigen::Matrix<double, 2, 3> by_point;
        const Eigen::Array2d pixel = lens.project(point, by_point);
        return (pixel >= low_).all() && (pixel <= high_).all() &&
               (point.head<2>() / point.z()).norm() < fold_ &&
               by_point.leftCols<2>().determinant() > 0;
    }

private:
    Eigen::Array2d low_, high_;
    double fold_;
};

}  // namespace trigpoint
