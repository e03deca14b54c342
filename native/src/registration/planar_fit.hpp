// Where a flat face's points lie in a picture: a plane, a lens, and a bend.
//
// The model is a homography to rays, and a lens by division (Fitzgibbon 2001): the ray of a pixel
// (x, y), taken from the lens's centre, is (x, y, 1 + k1 r² + k2 r⁴). That has fisheye lenses to
// 180° and beyond, and is inverted without a search. What both leave, because the lens is another
// or the face is not flat, a smooth bend takes up.
#pragma once

#include <Eigen/Core>

#include "image/numbers.hpp"

namespace trigpoint {

// Half of a picture's diagonal is 1 for a fit; no ray in front of the camera comes nearer to this.
constexpr double HORIZON = 1e-9;

// A smooth displacement over a face: Legendre polynomials of its coordinates, up to `degree`, whose
// constant and linear parts are the homography's. `middle`, `half`: of the part of the face that it
// was fitted to; `values`: of its polynomials, pixels; degree 0: none.
struct Bend {
    static constexpr int MOST_TERMS = 12;  // of degree 4

    Eigen::Vector2d middle = Eigen::Vector2d::Zero(), half = Eigen::Vector2d::Ones();
    int degree = 0;
    Eigen::Matrix<double, MOST_TERMS, 2> values = Eigen::Matrix<double, MOST_TERMS, 2>::Zero();

    // The displacement at a face point, pixels; beyond its part as at its edge.
    Eigen::Vector2d at(const Eigen::Vector2d& point) const;
    // The bend in what is left (n, 2) of face points; none where they are too few.
    static Bend of(const PointsIn& points, const PointsIn& left);
};

// How face coordinates (metres) become pixels. `homography`: face to undistorted pixels, taken from
// the lens's centre in units of `scale`, half a diagonal; `centre`: of the picture; `aside`: the
// lens's from there, in units of `scale`.
struct PlanarFit {
    static constexpr int NUMBERS = 16 + 5 + 2 * Bend::MOST_TERMS;

    Eigen::Matrix3d homography = Eigen::Matrix3d::Identity();
    Eigen::Vector2d radial = Eigen::Vector2d::Zero(), centre = Eigen::Vector2d::Zero(),
                    aside = Eigen::Vector2d::Zero();
    double scale = 1;
    Bend bend;

    // The picture's; nothing is fitted yet.
    static PlanarFit of_size(double width, double height);
    // As it crosses the border, NUMBERS. On its way out the homography is scaled, by a positive
    // number, so that its first two columns together have length 1, which stays so while a face
    // moves without turning.
    static PlanarFit unpacked(const double* numbers);
    void pack(double* numbers) const;

    // The pixel of a face point.
    Eigen::Vector2d project(const Eigen::Vector2d& point) const;
    // The same as if the face were flat.
    Eigen::Vector2d straight(const Eigen::Vector2d& point) const;
    // The distance of a pixel from where the fit puts its point.
    double residual(const Eigen::Vector2d& point, const Eigen::Vector2d& pixel) const {
        return (project(point) - pixel).norm();
    }
};

// From pixels back to a face: of one fit, for many pixels.
class Unprojection {
public:
    // `then`: where face points are moved on to.
    explicit Unprojection(const PlanarFit& fit,
                          const Eigen::Matrix3d& then = Eigen::Matrix3d::Identity());

    Eigen::Vector2d operator()(const Eigen::Vector2d& pixel) const;

private:
    static Eigen::Vector2d through(const Eigen::Matrix3d& map, const Eigen::Vector3d& ray);
    Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

    const PlanarFit* fit_;
    Eigen::Matrix3d inverse_, moved_;
};

// The share q of a ray (X, Y, Z), so that the picture has it at q · (X, Y): the root of
// 1 + k1 R² q² + k2 R⁴ q⁴ = Z q that is nearest the lens's centre.
double share_of(const Eigen::Vector3d& ray, const Eigen::Vector2d& radial);

}  // namespace trigpoint
