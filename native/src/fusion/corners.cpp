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

using ByUnknowns = Eigen::Matrix<double, 6, Eigen::Dynamic>;

// By a disturbance of a body of which that origin is an `arm` away from the one disturbed.
Matrix6d at_arm(const Eigen::Vector3d& arm) {
    Matrix6d by = Matrix6d::Identity();
    by.topRightCorner<3, 3>() = -hat(arm);
    return by;
}

}  // namespace

Index Picture::columns() const {
    return tangent.count + 6 + (has_lens ? lens.parameters() : 0) + (twist != nullptr ? 2 : 0) +
           (has_faces ? 6 * static_cast<Index>(faces.size()) : 0);
}

void Picture::terms(const Pose& robot, bool with_lens, Eigen::MatrixXd& rows) const {
    const Index parameters = with_lens ? lens.parameters() : 0;
    rows.resize(2 * corners, 6 + parameters + 1);
    Eigen::MatrixXd by_lens(2, lens.parameters());
    for (Index k = 0; k < corners; ++k) {
        if (face[k] < 0 || face[k] >= static_cast<std::int64_t>(faces.size()))
            throw std::out_of_range("no such face");
        const double weight = weights[k];
        if (weight == 0) {
            rows.middleRows<2>(2 * k).setZero();
            continue;
        }
        const Pose& base_from_face = faces[static_cast<std::size_t>(face[k])];
        const Eigen::Vector3d in_robot =
            robot.rotation *
            (base_from_face.rotation * Eigen::Map<const Eigen::Vector3d>(points + 3 * k) +
             base_from_face.translation);
        Eigen::Vector3d optical =
            camera.rotation.transpose() * (in_robot + (robot.translation - camera.translation));
        if (!(optical.z() > NEAREST_M)) optical.z() = NEAREST_M;
        Eigen::Matrix<double, 2, 3> by_optical;
        const Eigen::Vector2d pixel = lens.project(optical, by_optical);
        rows.block<2, 6>(2 * k, 0) =
            by_disturbance((weight * by_optical) * camera.rotation.transpose(), in_robot);
        rows.block<2, 1>(2 * k, 6 + parameters) =
            weight * (pixel - Eigen::Map<const Eigen::Vector2d>(pixels + 2 * k));
        if (!with_lens) continue;
        lens.by_parameters(optical, by_lens);
        rows.block(2 * k, 6, 2, parameters) = weight * by_lens;
    }
}

ByUnknowns Picture::by_unknowns(const Pose& robot, std::int64_t of_face) const {
    ByUnknowns by = ByUnknowns::Zero(6, columns());
    // The robot deviates in the map's axes from where its node puts it.
    Matrix6d by_node = at_arm(seen.translation - node.translation);
    by_node.bottomRightCorner<3, 3>() = robot.rotation * seen.rotation.transpose();
    for (Index i = 0; i < tangent.count; ++i) by.col(i) = by_node.col(tangent.axes[i]);
    by.middleCols<6>(tangent.count) = -at_arm(robot.translation - camera.translation);
    Index next = tangent.count + 6 + (has_lens ? lens.parameters() : 0);
    if (twist != nullptr) {
        Vector6d by_time;
        by_time << seen.rotation * Eigen::Map<const Eigen::Vector3d>(twist),
            robot.rotation * Eigen::Map<const Eigen::Vector3d>(twist + 3);
        by.col(next) = -by_time;
        by.col(next + 1) = -since_epoch_s * by_time;
        next += 2;
    }
    if (has_faces) {
        const Pose& base_from_face = faces[static_cast<std::size_t>(of_face)];
        auto by_face = by.middleCols<6>(next + 6 * of_face);
        by_face = at_arm(-(robot.rotation * base_from_face.translation));
        by_face.leftCols<3>() *= robot.rotation;
        by_face.rightCols<3>() *= robot.rotation;
    }
    return by;
}

RowMajor Picture::jacobian(const Pose& robot, const Eigen::MatrixXd& rows) const {
    RowMajor found(rows.rows(), columns());
    each_run([&](Index first, Index count, std::int64_t of_face) {
        found.middleRows(2 * first, 2 * count) =
            rows.block(2 * first, 0, 2 * count, 6) * by_unknowns(robot, of_face);
    });
    if (has_lens)
        found.middleCols(tangent.count + 6, lens.parameters()) =
            rows.middleCols(6, lens.parameters());
    return found;
}

void PictureEquations::square_terms(Index first, Index count) {
    const Index columns = rows_.cols();
    gram_.resize(columns, columns);
    for (Index i = 0; i < columns; ++i)
        for (Index j = 0; j <= i; ++j)
            gram_(i, j) = gram_(j, i) = rows_.col(i)
                                            .segment(2 * first, 2 * count)
                                            .dot(rows_.col(j).segment(2 * first, 2 * count));
}

// By how much another deviation than the one `about` which they are explains the terms better.
Vector6d PictureEquations::fitted(const Vector6d& variances, const Vector6d& about) {
    square_terms(0, rows_.rows() / 2);
    Matrix6d information = by_deviation_.transpose() * gram_.topLeftCorner<6, 6>() * by_deviation_;
    information.diagonal() += variances.cwiseInverse();
    return -information.llt().solve(by_deviation_.transpose() *
                                        gram_.col(gram_.cols() - 1).head<6>() +
                                    about.cwiseQuotient(variances));
}

void PictureEquations::set(const Picture& picture, const double* variances, double huber) {
    const Index columns = picture.columns(), shared = variances != nullptr ? 6 : 0;
    seen_ = picture.seen;
    by_deviation_.setIdentity();
    deviation_.setZero();
    Vector6d known;
    if (shared) {
        known = Eigen::Map<const Vector6d>(variances);
        picture.terms(seen_, false, rows_);
        deviation_ = fitted(known, deviation_);
        seen_ = seen_.disturbed(deviation_);
        by_deviation_.bottomRightCorner<3, 3>() = left_jacobian(deviation_.tail<3>());
    }
    picture.terms(seen_, picture.has_lens, rows_);
    const Index others = rows_.cols() - 6, lens = picture.tangent.count + 6;
    cost = log_determinant = 0;
    if (std::isfinite(huber)) {
        Eigen::VectorXd left = rows_.rightCols<1>();
        if (shared) left += rows_.leftCols<6>() * (by_deviation_ * fitted(known, deviation_));
        for (Index k = 0; k < picture.corners; ++k) {
            const double length = left.segment<2>(2 * k).norm();
            if (!(length > huber)) continue;
            rows_.middleRows<2>(2 * k) *= std::sqrt(huber / length);
            cost += huber * (length - huber);
        }
    }
    const Index size = shared + columns + 1;
    whole_.setZero(size, size);
    picture.each_run([&](Index first, Index count, std::int64_t face) {
        square_terms(first, count);
        ByUnknowns by = ByUnknowns::Zero(6, size);
        if (shared) by.leftCols<6>() = by_deviation_;
        by.middleCols(shared, columns) = picture.by_unknowns(seen_, face);
        const ByUnknowns pulled = gram_.topLeftCorner<6, 6>() * by;
        const auto own = gram_.bottomRightCorner(others, others);
        const Eigen::MatrixXd across = by.transpose().lazyProduct(gram_.topRightCorner(6, others));
        whole_ += by.transpose().lazyProduct(pulled);
        // Of the lens, and of the residual.
        const std::pair<Index, Index> parts[] = {{shared + lens, others - 1}, {size - 1, 1}};
        Index from = 0;
        for (const auto& [at, width] : parts) {
            whole_.middleCols(at, width) += across.middleCols(from, width);
            whole_.middleRows(at, width) += across.middleCols(from, width).transpose();
            Index other = 0;
            for (const auto& [there, wide] : parts) {
                whole_.block(at, there, width, wide) += own.block(from, other, width, wide);
                other += wide;
            }
            from += width;
        }
    });
    square = whole_.bottomRightCorner(columns + 1, columns + 1);
    if (shared) {
        const Vector6d pull = deviation_.cwiseQuotient(known);
        whole_.diagonal().head<6>() += known.cwiseInverse();
        whole_.col(size - 1).head<6>() += pull;
        square(columns, columns) += deviation_.dot(pull);
        const Eigen::LLT<Matrix6d> root(whole_.topLeftCorner<6, 6>());
        if (root.info() != Eigen::Success) {  // refused as a step that is not finite
            cost = std::numeric_limits<double>::quiet_NaN();
            return;
        }
        const ByUnknowns across = root.matrixL().solve(whole_.topRightCorner(6, columns + 1));
        square -= across.transpose().lazyProduct(across);
        log_determinant =
            2 * root.matrixLLT().diagonal().array().log().sum() + known.array().log().sum();
    }
    cost += square(columns, columns);
}

Eigen::MatrixXd PictureEquations::factor(const Picture& picture, const double* variances) const {
    const Index columns = picture.columns() + 1, shared = variances != nullptr ? 6 : 0,
                count = rows_.rows();
    Eigen::MatrixXd whole =
        Eigen::MatrixXd::Zero(std::max(shared + count, shared + columns), shared + columns);
    for (Index k = 0; k < shared; ++k) {
        whole(k, k) = 1 / std::sqrt(variances[k]);
        whole(k, shared + columns - 1) = whole(k, k) * deviation_[k];
    }
    if (shared) whole.block(shared, 0, count, 6) = rows_.leftCols<6>() * by_deviation_;
    whole.block(shared, shared, count, columns - 1) = picture.jacobian(seen_, rows_);
    whole.block(shared, shared + columns - 1, count, 1) = rows_.rightCols<1>();
    const Eigen::HouseholderQR<Eigen::Ref<Eigen::MatrixXd>> turned(whole);
    return turned.matrixQR().block(shared, shared, columns, columns).triangularView<Eigen::Upper>();
}

}  // namespace trigpoint

using namespace trigpoint;

namespace {

// Pictures as Python has them: the lens (p,), the camera (1, 12), the nodes (n, 12), the robot as
// it was seen (n, 12), base_from_face (f, 12), faces (n, k), points in them (n, k, 3), pixels (n,
// k, 2), weights (n, k), twists (n or 0, 6), since the epoch (n,), tangent (d,), has a lens, has
// faces.
class Pictures {
public:
    static constexpr int ARGUMENTS = 14;

    explicit Pictures(const Argument* given)
        : given_(given),
          count(given[8].array.shape[0]),
          corners(given[8].array.shape[1]),
          tangent_(given[11].array.as<std::int64_t>(), given[11].array.shape[0]) {
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
                given_[13].whole != 0,
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
    std::vector<Pose> faces_;
};

}  // namespace

// (pictures, residuals (n, k, 2), Jacobian (n, k, 2 c), by the robot as it was seen (n, k, 12)): 0;
// arrays without columns are not wanted. Without a Jacobian, nor need the tangent be.
TRIGPOINT_KERNEL(tp_corner_terms) {
    const Pictures pictures(arguments);
    const Argument* asked = arguments + Pictures::ARGUMENTS;
    const auto numbers = [&](int which) { return asked[which].array.as<double>(); };
    const Index rows = 2 * pictures.corners, columns = asked[1].array.shape[2] / 2,
                by_six = asked[2].array.shape[2];
    if (by_six != 0 && by_six != 12) throw std::invalid_argument("a pose has six components");
    Eigen::MatrixXd terms;
    for (Index n = 0; n < pictures.count; ++n) {
        const Picture picture = pictures.at(n);
        if (columns != 0 && columns != picture.columns())
            throw std::invalid_argument("other columns are wanted");
        picture.terms(picture.seen, columns > 0 && picture.has_lens, terms);
        Eigen::Map<Eigen::VectorXd>(numbers(0) + rows * n, rows) = terms.rightCols<1>();
        if (columns > 0)
            Eigen::Map<RowMajor>(numbers(1) + rows * columns * n, rows, columns) =
                picture.jacobian(picture.seen, terms);
        if (by_six > 0)
            Eigen::Map<ByPoses>(numbers(2) + 6 * rows * n, rows, 6) = terms.leftCols<6>();
    }
    return 0;
}

// (pictures, n = 1, variances (0 or 6,) of the robot's deviation in it, factor (c + 1, c + 1)): 0;
// `PictureEquations.factor`.
TRIGPOINT_KERNEL(tp_corner_factor) {
    const Pictures pictures(arguments);
    const Argument* asked = arguments + Pictures::ARGUMENTS;
    const Array& variances = asked[0].array;
    if (pictures.count != 1 || (variances.shape[0] != 0 && variances.shape[0] != 6))
        throw std::invalid_argument("one picture, whose deviation has six variances or none");
    const Picture picture = pictures.at(0);
    const Index columns = picture.columns() + 1;
    if (asked[1].array.shape[0] != columns) throw std::invalid_argument("other columns are wanted");
    PictureEquations equations;
    const double* given = variances.shape[0] ? variances.as<double>() : nullptr;
    equations.set(picture, given, std::numeric_limits<double>::infinity());
    Eigen::Map<RowMajor>(asked[1].array.as<double>(), columns, columns) =
        equations.factor(picture, given);
    return 0;
}
