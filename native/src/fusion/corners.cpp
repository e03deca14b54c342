// The corners of a batch of pictures: residuals, their derivatives by every unknown, and the normal
// equations of these.
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <stdexcept>

#include "border.hpp"
#include "fusion/pose_fitting.hpp"

using namespace trigpoint;

namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Index = Eigen::Index;

// What a batch is given as: lens (p,), the camera's rotation (1, 3, 3) and translation (1, 3), the
// nodes' (n, …), those of the robot as it was seen (n, …), base_from_face (f, …), faces (n, k),
// points in their faces (n, k, 3), pixels (n, k, 2), weights (n, k), twists (n or 0, 6), since the
// epoch (n,), tangent (d,), has a lens, has faces.
class Batch {
public:
    explicit Batch(const Argument* given)
        : given_(given),
          lens_(numbers(0), given[0].array.shape[0]),
          camera_(pose_at(numbers(1), numbers(2), 0)),
          has_clock_(given[13].array.shape[0] > 0),
          has_lens_(given[16].whole != 0),
          has_faces_(given[17].whole != 0),
          by_lens_(2, lens_.parameters()) {
        for (Index i = 0; i < tangents(); ++i)
            if (const auto axis = tangent(i); axis < 0 || axis > 5)
                throw std::out_of_range("a pose has six components");
        if (has_clock_ && given[13].array.shape[0] != pictures())
            throw std::invalid_argument("not every picture has a twist");
    }

    Index pictures() const { return given_[12].array.shape[0]; }
    Index corners() const { return given_[12].array.shape[1]; }
    // Of the node, 6 of the camera, p of its lens, 2 of its clock, 6 f of the faces, as far as they
    // are wanted.
    Index columns() const {
        return tangents() + 6 + (has_lens_ ? lens_.parameters() : 0) + (has_clock_ ? 2 : 0) +
               (has_faces_ ? 6 * faces() : 0);
    }
    Pose seen(Index n) const { return pose_at(numbers(5), numbers(6), n); }

    // A picture's residuals (2 k,) with the robot at a pose, their derivatives by the unknowns
    // (2 k, columns) and by that pose (2 k, 6), where these have rows.
    template <class Residual, class Jacobian, class BySeen>
    void terms(Index n, const Pose& robot, Residual&& residual, Jacobian&& jacobian,
               BySeen&& by_seen) {
        const Pose node = pose_at(numbers(3), numbers(4), n);
        Eigen::Vector3d speed = Eigen::Vector3d::Zero(), turning = speed;
        if (has_clock_) {
            const double* twist = numbers(13) + 6 * n;
            speed = robot.rotation * Eigen::Map<const Eigen::Vector3d>(twist);
            turning = robot.rotation * Eigen::Map<const Eigen::Vector3d>(twist + 3);
        }
        for (Index k = 0; k < corners(); ++k) {
            const Index at = n * corners() + k;
            const double weight = numbers(12)[at];
            const std::int64_t face = given_[9].array.as<std::int64_t>()[at];
            if (face < 0 || face >= faces()) throw std::out_of_range("no such face");
            const Pose base_from_face = pose_at(numbers(7), numbers(8), face);
            const Eigen::Vector3d in_face =
                base_from_face.rotation * Eigen::Map<const Eigen::Vector3d>(numbers(10) + 3 * at);
            const Eigen::Vector3d in_robot =
                robot.rotation * (in_face + base_from_face.translation);
            const Eigen::Vector3d arm = in_robot + (robot.translation - node.translation);
            const Eigen::Vector3d from_camera = arm + (node.translation - camera_.translation);
            Eigen::Vector3d optical = camera_.rotation.transpose() * from_camera;
            if (!(optical.z() > NEAREST_M)) optical.z() = NEAREST_M;
            if (!(weight > 0)) optical.z() = 1;
            Eigen::Matrix<double, 2, 3> by_optical;
            const Eigen::Vector2d pixel = lens_.project(optical, by_optical);
            residual.template segment<2>(2 * k) =
                weight * (pixel - Eigen::Map<const Eigen::Vector2d>(numbers(11) + 2 * at));
            const Eigen::Matrix<double, 2, 3> by_map =
                (weight * by_optical) * camera_.rotation.transpose();
            if (by_seen.rows() > 0)
                by_seen.template middleRows<2>(2 * k) = by_disturbance(by_map, in_robot);
            if (jacobian.rows() == 0) continue;
            auto by = jacobian.template middleRows<2>(2 * k);
            const ByPose by_node = by_disturbance(by_map, arm);
            for (Index i = 0; i < tangents(); ++i) by.col(i) = by_node.col(tangent(i));
            by.template middleCols<6>(tangents()) = by_disturbance(-by_map, from_camera);
            Index next = tangents() + 6;
            if (has_lens_) {
                lens_.by_parameters(optical, by_lens_);
                by.middleCols(next, lens_.parameters()) = weight * by_lens_;
                next += lens_.parameters();
            }
            if (has_clock_) {
                const Eigen::Vector2d by_time = -by_map * (speed + turning.cross(in_robot));
                by.col(next) = by_time;
                by.col(next + 1) = by_time * numbers(14)[n];
                next += 2;
            }
            if (has_faces_) {
                by.rightCols(by.cols() - next).setZero();
                by.template middleCols<6>(next + 6 * face) =
                    by_disturbance(by_map * robot.rotation, in_face);
            }
        }
    }

private:
    const Argument* given_;
    Lens lens_;
    Pose camera_;
    bool has_clock_, has_lens_, has_faces_;
    Eigen::MatrixXd by_lens_;

    double* numbers(int which) const { return given_[which].array.as<double>(); }
    Index faces() const { return given_[7].array.shape[0]; }
    Index tangents() const { return given_[15].array.shape[0]; }
    std::int64_t tangent(Index i) const { return given_[15].array.as<std::int64_t>()[i]; }
};

// The disturbance of the robot that all corners of a picture share, of which `variances` are known:
// eliminated, it leaves the squares of `left` and `own` (`PictureJitter`).
struct Shared {
    Eigen::LLT<Matrix6d> information;
    const ByPoses& by;
    Vector6d variances;

    Shared(const ByPoses& by_seen, const Vector6d& prior) : by(by_seen), variances(prior) {
        Matrix6d whole = by.transpose() * by;
        whole.diagonal() += variances.cwiseInverse();
        information.compute(whole);
    }
    template <class Right>
    auto fit(const Right& rows) const {
        return information.solve(by.transpose() * rows).eval();
    }
    double log_determinant() const {
        return 2 * information.matrixLLT().diagonal().array().log().sum() +
               variances.array().log().sum();
    }
};

}  // namespace

// (a batch, residuals (n, k, 2), Jacobian (n, k, 2 c), by the robot as it was seen (n, k, 12)): 0;
// arrays without columns are not wanted. Without a Jacobian, nor need the tangent be.
TRIGPOINT_KERNEL(tp_corner_terms) {
    Batch batch(arguments);
    const Index rows = 2 * batch.corners(), columns = arguments[19].array.shape[2] / 2;
    const bool is_by_seen = arguments[20].array.shape[2] > 0;
    if (columns != 0 && columns != batch.columns())
        throw std::invalid_argument("other columns are wanted");
    if (is_by_seen && arguments[20].array.shape[2] != 12)
        throw std::invalid_argument("a pose has six components");
    for (Index n = 0; n < batch.pictures(); ++n)
        batch.terms(n, batch.seen(n),
                    Eigen::Map<Eigen::VectorXd>(arguments[18].array.as<double>() + rows * n, rows),
                    Eigen::Map<Rows>(arguments[19].array.as<double>() + rows * columns * n,
                                     columns > 0 ? rows : 0, columns),
                    Eigen::Map<ByPoses>(arguments[20].array.as<double>() + 6 * rows * n,
                                        is_by_seen ? rows : 0, 6));
    return 0;
}

// (a batch, variances of the robot's deviation (n or 0, 6), sigmas beyond which the cost is linear,
// Hessian (n, c, c), gradient (n, c), cost and ln|covariance| (2,)): 0; of each picture, with the
// robot's deviation in it eliminated.
TRIGPOINT_KERNEL(tp_corner_equations) {
    Batch batch(arguments);
    const Index count = 2 * batch.corners(), columns = batch.columns();
    const Array &jitter = arguments[18].array, &gradients = arguments[21].array;
    const double huber = arguments[19].number;
    if (gradients.shape[1] != columns) throw std::invalid_argument("other columns are wanted");
    const bool is_shared = jitter.shape[0] > 0;
    if (is_shared && jitter.shape[0] != batch.pictures())
        throw std::invalid_argument("not every picture has a deviation");
    Rows rows(count, columns + 1);  // the Jacobian, and the residual
    ByPoses by_seen(is_shared ? count : 0, 6), none(0, 6);
    Eigen::VectorXd residual(count), root(count), left;
    double cost = 0, log_determinant = 0;
    for (Index n = 0; n < batch.pictures(); ++n) {
        batch.terms(n, batch.seen(n), residual, rows.leftCols(columns), by_seen);
        left = residual;
        Vector6d variances;
        if (is_shared) {
            variances = Eigen::Map<const Vector6d>(jitter.as<double>() + 6 * n);
            const Shared shared(by_seen, variances);
            // Linearised about the deviation that fits best: what a tilt leaves has one sign.
            const Vector6d fit = -shared.fit(residual);
            batch.terms(n, batch.seen(n).disturbed(fit), residual, Rows(0, columns), none);
            residual -= by_seen * fit;
            left = residual - by_seen * shared.fit(residual);
        }
        for (Index k = 0; k < count / 2; ++k) {
            const double length = left.segment<2>(2 * k).norm();
            const double weight = std::min(1.0, huber / std::max(length, 1e-12));
            root.segment<2>(2 * k).setConstant(std::sqrt(weight));
            if (is_shared)
                cost += weight < 1 ? huber * (length - huber) : 0;
            else
                cost += weight < 1 ? huber * (2 * length - huber) : length * length;
        }
        rows.col(columns) = residual;
        if ((root.array() < 1).any()) rows = root.asDiagonal() * rows;
        Eigen::MatrixXd square;
        if (is_shared) {
            by_seen = (root.asDiagonal() * by_seen).eval();
            const Shared shared(by_seen, variances);
            const Eigen::Matrix<double, 6, Eigen::Dynamic> fit = shared.fit(rows);
            rows -= by_seen * fit;
            const Eigen::Matrix<double, 6, Eigen::Dynamic> own =
                variances.cwiseSqrt().cwiseInverse().asDiagonal() * fit;
            square = rows.transpose() * rows;
            square += own.transpose() * own;
            cost += square(columns, columns);
            log_determinant += shared.log_determinant();
        } else {
            square = rows.transpose() * rows;
        }
        Eigen::Map<Rows>(arguments[20].array.as<double>() + columns * columns * n, columns,
                         columns) = square.topLeftCorner(columns, columns);
        Eigen::Map<Eigen::VectorXd>(gradients.as<double>() + columns * n, columns) =
            square.col(columns).head(columns);
    }
    arguments[22].array.as<double>()[0] = cost;
    arguments[22].array.as<double>()[1] = log_determinant;
    return 0;
}
