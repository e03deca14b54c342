#include "fusion/corners.hpp"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <limits>
#include <stdexcept>

#include "border.hpp"

namespace trigpoint {

namespace {

using Index = Eigen::Index;

// The disturbance of the robot that all corners of a picture share, of which `variances` are known:
// eliminated, it leaves the squares of what it does not explain and of its own prior's residual.
struct Shared {
    Eigen::LLT<Matrix6d> information;
    const ByPoses& by;
    Vector6d variances;

    Shared(const ByPoses& by_seen, const double* prior)
        : by(by_seen), variances(Eigen::Map<const Vector6d>(prior)) {
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

Index Picture::columns() const {
    return tangent.count + 6 + (has_lens ? lens.parameters() : 0) + (twist != nullptr ? 2 : 0) +
           6 * static_cast<Index>(face_columns.size());
}

void Picture::terms(const Pose& robot, Eigen::Ref<Eigen::VectorXd> residual,
                    Eigen::Ref<RowMajor> jacobian, Eigen::Ref<ByPoses> by_seen) const {
    Eigen::Vector3d speed = Eigen::Vector3d::Zero(), turning = speed;
    if (twist != nullptr) {
        speed = robot.rotation * Eigen::Map<const Eigen::Vector3d>(twist);
        turning = robot.rotation * Eigen::Map<const Eigen::Vector3d>(twist + 3);
    }
    Eigen::MatrixXd by_lens(2, lens.parameters());
    for (Index k = 0; k < corners; ++k) {
        if (face[k] < 0 || face[k] >= static_cast<std::int64_t>(faces.size()))
            throw std::out_of_range("no such face");
        const double weight = weights[k];
        if (weight == 0) {
            residual.segment<2>(2 * k).setZero();
            if (by_seen.rows() > 0) by_seen.middleRows<2>(2 * k).setZero();
            if (jacobian.rows() > 0) jacobian.middleRows<2>(2 * k).setZero();
            continue;
        }
        const Pose& base_from_face = faces[static_cast<std::size_t>(face[k])];
        const Eigen::Vector3d in_face =
            base_from_face.rotation * Eigen::Map<const Eigen::Vector3d>(points + 3 * k);
        const Eigen::Vector3d in_robot = robot.rotation * (in_face + base_from_face.translation);
        const Eigen::Vector3d arm = in_robot + (robot.translation - node.translation);
        const Eigen::Vector3d from_camera = arm + (node.translation - camera.translation);
        Eigen::Vector3d optical = camera.rotation.transpose() * from_camera;
        if (!(optical.z() > NEAREST_M)) optical.z() = NEAREST_M;
        Eigen::Matrix<double, 2, 3> by_optical;
        const Eigen::Vector2d pixel = lens.project(optical, by_optical);
        residual.segment<2>(2 * k) =
            weight * (pixel - Eigen::Map<const Eigen::Vector2d>(pixels + 2 * k));
        const Eigen::Matrix<double, 2, 3> by_map =
            (weight * by_optical) * camera.rotation.transpose();
        if (by_seen.rows() > 0) by_seen.middleRows<2>(2 * k) = by_disturbance(by_map, in_robot);
        if (jacobian.rows() == 0) continue;
        auto by = jacobian.middleRows<2>(2 * k);
        const ByPose by_node = by_disturbance(by_map, arm);
        for (Index i = 0; i < tangent.count; ++i) by.col(i) = by_node.col(tangent.axes[i]);
        by.middleCols<6>(tangent.count) = by_disturbance(-by_map, from_camera);
        Index next = tangent.count + 6;
        if (has_lens) {
            lens.by_parameters(optical, by_lens);
            by.middleCols(next, lens.parameters()) = weight * by_lens;
            next += lens.parameters();
        }
        if (twist != nullptr) {
            const Eigen::Vector2d by_time = -by_map * (speed + turning.cross(in_robot));
            by.col(next) = by_time;
            by.col(next + 1) = by_time * since_epoch_s;
            next += 2;
        }
        for (const Index which : face_columns) {
            if (which == face[k])
                by.middleCols<6>(next) = by_disturbance(by_map * robot.rotation, in_face);
            else
                by.middleCols<6>(next).setZero();
            next += 6;
        }
    }
}

void PictureEquations::set(Picture picture, const double* variances, double huber) {
    // Tables pad pictures to the widest.
    while (picture.corners > 0 && picture.weights[picture.corners - 1] == 0) --picture.corners;
    const Index count = 2 * picture.corners, columns = picture.columns();
    const bool is_shared = variances != nullptr;
    rows_.resize(count, columns + 1);  // the Jacobian, and the residual
    by_seen_.resize(is_shared ? count : 0, 6);
    residual_.resize(count);
    root_.resize(count);
    cost = log_determinant = 0;
    picture.terms(picture.seen, residual_, rows_.leftCols(columns), by_seen_);
    left_ = residual_;
    if (is_shared) {
        const Vector6d fit = -Shared(by_seen_, variances + 6).fit(residual_);
        RowMajor no_rows(0, columns);
        ByPoses none(0, 6);
        picture.terms(picture.seen.disturbed(fit), residual_, no_rows, none);
        residual_ -= by_seen_ * fit;
        left_ = residual_ - by_seen_ * Shared(by_seen_, variances).fit(residual_);
    }
    for (Index k = 0; k < picture.corners; ++k) {
        const double length = left_.segment<2>(2 * k).norm();
        const double weight = std::min(1.0, huber / std::max(length, 1e-12));
        root_.segment<2>(2 * k).setConstant(std::sqrt(weight));
        if (is_shared)
            cost += weight < 1 ? huber * (length - huber) : 0;
        else
            cost += weight < 1 ? huber * (2 * length - huber) : length * length;
    }
    rows_.col(columns) = residual_;
    if ((root_.array() < 1).any()) rows_ = root_.asDiagonal() * rows_;
    if (is_shared) {
        by_seen_ = (root_.asDiagonal() * by_seen_).eval();
        const Shared shared(by_seen_, variances);
        const Eigen::Matrix<double, 6, Eigen::Dynamic> fit = shared.fit(rows_);
        rows_ -= by_seen_ * fit;
        own_ = shared.variances.cwiseSqrt().cwiseInverse().asDiagonal() * fit;
        set_square();
        cost += square(columns, columns);
        log_determinant = shared.log_determinant();
    } else {
        own_.setZero(6, columns + 1);
        set_square();
    }
}

// Half of it is worked out, the other is the same.
void PictureEquations::set_square() {
    square.setZero(rows_.cols(), rows_.cols());
    auto lower = square.selfadjointView<Eigen::Lower>();
    lower.rankUpdate(rows_.transpose());
    lower.rankUpdate(own_.transpose());
    square.triangularView<Eigen::StrictlyUpper>() = square.transpose();
}

Eigen::MatrixXd PictureEquations::factor() const {
    const Index columns = rows_.cols();
    Eigen::MatrixXd whole =
        Eigen::MatrixXd::Zero(std::max<Index>(rows_.rows() + own_.rows(), columns), columns);
    whole.topRows(rows_.rows()) = rows_;
    whole.middleRows(rows_.rows(), own_.rows()) = own_;
    const Eigen::HouseholderQR<Eigen::Ref<Eigen::MatrixXd>> turned(whole);
    return turned.matrixQR().topRows(columns).triangularView<Eigen::Upper>();
}

}  // namespace trigpoint

using namespace trigpoint;

namespace {

// Pictures as Python has them: the lens (p,), the camera (1, 12), the nodes (n, 12), the robot as
// it was seen (n, 12), base_from_face (f, 12), faces (n, k), points in them (n, k, 3), pixels (n,
// k, 2), weights (n, k), twists (n or 0, 6), since the epoch (n,), tangent (d,), has a lens, faces
// that have columns (e,).
class Pictures {
public:
    static constexpr int ARGUMENTS = 14;

    explicit Pictures(const Argument* given)
        : given_(given),
          count(given[8].array.shape[0]),
          corners(given[8].array.shape[1]),
          tangent_(given[11].array.as<std::int64_t>(), given[11].array.shape[0]),
          face_columns_(given[13].array.as<std::int64_t>(),
                        given[13].array.as<std::int64_t>() + given[13].array.shape[0]) {
        const Index twists = given[9].array.shape[0];
        if (twists > 0 && twists != count)
            throw std::invalid_argument("not every picture has a twist");
        for (Index f = 0; f < given[4].array.shape[0]; ++f)
            faces_.push_back(pose_at(numbers(4) + 12 * f));
    }
    Picture at(Index n) const {
        return {Lens(numbers(0), given_[0].array.shape[0]),
                pose_at(numbers(1)),
                pose_at(numbers(2) + 12 * n),
                pose_at(numbers(3) + 12 * n),
                given_[9].array.shape[0] > 0 ? numbers(9) + 6 * n : nullptr,
                numbers(10)[n],
                faces_,
                tangent_,
                given_[12].whole != 0,
                face_columns_,
                corners,
                given_[5].array.as<std::int64_t>() + corners * n,
                numbers(6) + 3 * corners * n,
                numbers(7) + 2 * corners * n,
                numbers(8) + corners * n};
    }

private:
    const double* numbers(int which) const { return given_[which].array.as<double>(); }
    const Argument* given_;

public:
    const Index count, corners;

private:
    Tangent tangent_;
    std::vector<Index> face_columns_;
    std::vector<Pose> faces_;
};

}  // namespace

// (pictures, residuals (n, k, 2), Jacobian (n, k, 2 c), or without columns): 0. Without a Jacobian
// the tangent need not be, either.
TRIGPOINT_KERNEL(tp_corner_terms) {
    const Pictures pictures(arguments);
    const Argument* asked = arguments + Pictures::ARGUMENTS;
    const auto numbers = [&](int which) { return asked[which].array.as<double>(); };
    const Index rows = 2 * pictures.corners, columns = asked[1].array.shape[2] / 2;
    ByPoses not_wanted(0, 6);
    for (Index n = 0; n < pictures.count; ++n) {
        const Picture picture = pictures.at(n);
        if (columns != 0 && columns != picture.columns())
            throw std::invalid_argument("other columns are wanted");
        picture.terms(
            picture.seen, Eigen::Map<Eigen::VectorXd>(numbers(0) + rows * n, rows),
            Eigen::Map<RowMajor>(numbers(1) + rows * columns * n, columns > 0 ? rows : 0, columns),
            not_wanted);
    }
    return 0;
}

// (pictures, n = 1, variances (0 or 12,) of the robot's deviation in it, factor (c + 1, c + 1)): 0;
// `PictureEquations.set`, `PictureEquations.factor`.
TRIGPOINT_KERNEL(tp_corner_factor) {
    const Pictures pictures(arguments);
    const Argument* asked = arguments + Pictures::ARGUMENTS;
    const Array& variances = asked[0].array;
    if (pictures.count != 1 || (variances.shape[0] != 0 && variances.shape[0] != 12))
        throw std::invalid_argument("one picture, whose deviation has twelve variances or none");
    const Picture picture = pictures.at(0);
    const Index columns = picture.columns() + 1;
    if (asked[1].array.shape[0] != columns) throw std::invalid_argument("other columns are wanted");
    PictureEquations equations;
    equations.set(picture, variances.shape[0] ? variances.as<double>() : nullptr,
                  std::numeric_limits<double>::infinity());
    Eigen::Map<RowMajor>(asked[1].array.as<double>(), columns, columns) = equations.factor();
    return 0;
}
