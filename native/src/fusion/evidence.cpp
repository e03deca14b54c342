#include "fusion/evidence.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>

using namespace trigpoint;

namespace {

using Wide = Eigen::Matrix<double, 6, Eigen::Dynamic>;

// A sighting's share of 1 that is left of its pose's variance, at least.
constexpr double LEAST_LEFT = 1e-6;

// A sighting's derivatives by its pose and by the unknowns (2 k, q), and its residuals; `weight`: 0
// of wild corners; `covariance`: of the unknowns, with the sighting if it `is_used`; `rest`: the χ²
// by which the state may still be off its minimum.
Innovation innovation(const Sighting& seen, const RowMajor& by_state, const Eigen::VectorXd& weight,
                      const Eigen::MatrixXd& covariance, const Vector6d& room, bool is_used,
                      double rest) {
    const Innovation none{false, 0, 0};
    Matrix6d information = room.cwiseInverse().asDiagonal();
    Vector6d pull = Vector6d::Zero();
    Wide across = Wide::Zero(6, by_state.cols());
    for (Eigen::Index k = 0; k < seen.corners(); ++k) {
        if (weight(k) == 0) continue;
        const auto by = seen.by_pose.middleRows<2>(2 * k);
        information.noalias() += by.transpose() * by;
        pull.noalias() += by.transpose() * seen.residual.segment<2>(2 * k);
        across.noalias() += by.transpose() * by_state.middleRows<2>(2 * k);
    }
    if (!information.allFinite()) return none;
    const Eigen::LLT<Matrix6d> known(information);
    if (known.info() != Eigen::Success) return none;
    const Eigen::LLT<Matrix6d> own(known.solve(Matrix6d::Identity()));
    if (own.info() != Eigen::Success) return none;
    Wide whitened = across;  // Eigen solves for no column by an address that is none
    if (across.cols() > 0) whitened = own.matrixL().solve(known.solve(across));
    const Matrix6d predicted = whitened * covariance * whitened.transpose();
    if (!predicted.allFinite()) return none;
    const Eigen::SelfAdjointEigenSolver<Matrix6d> parts(predicted);
    const Vector6d step = own.matrixL().solve(-known.solve(pull));
    const Vector6d pulled =
        ((parts.eigenvectors().transpose() * step).array().abs() - std::sqrt(rest))
            .max(0.0)
            .matrix();
    const auto values = parts.eigenvalues().array();
    Vector6d left;
    if (is_used)
        left = (1 - values).max(LEAST_LEFT).min(1.0).matrix();
    else
        left = (1 + values.max(0.0)).matrix();
    const double own_spread = 2 * own.matrixLLT().diagonal().array().log().sum();
    return {true, (pulled.array().square() / left.array()).sum(),
            own_spread + (is_used ? -1 : 1) * left.array().log().sum()};
}

// The robot's disturbance about its node in one picture, by the corners that are used: through it
// the picture's views constrain each other. Its mean, its covariance given the unknowns, and its
// derivative by these.
struct Stood {
    Vector6d shift;
    Matrix6d own;
    Wide by_state;

    Stood(const ByPoses& by_base, const Eigen::VectorXd& residual, const RowMajor& jacobian,
          const Vector6d& variances) {
        Matrix6d information = by_base.transpose() * by_base;
        information.diagonal() += variances.cwiseInverse();
        own = information.inverse();
        shift = -own * (by_base.transpose() * residual);
        by_state = -own * (by_base.transpose() * jacobian);
    }
    // The covariance of the unknowns and the disturbance together.
    Eigen::MatrixXd beside(const Eigen::MatrixXd& covariance) const {
        const Eigen::Index q = covariance.rows();
        const Wide across = by_state * covariance;
        Eigen::MatrixXd joint(q + 6, q + 6);
        joint.topLeftCorner(q, q) = covariance;
        joint.bottomLeftCorner(6, q) = across;
        joint.topRightCorner(q, 6) = across.transpose();
        joint.bottomRightCorner<6, 6>() = own + across * by_state.transpose();
        return joint;
    }
};

}  // namespace

Pictured trigpoint::pictured(const Picture& picture) {
    const Eigen::Index rows = 2 * picture.corners;
    Pictured seen{ByPoses(rows, 6), RowMajor(rows, picture.columns()), Eigen::VectorXd(rows)};
    picture.terms(picture.seen, seen.residual, seen.jacobian, seen.by_base);
    return seen;
}

std::vector<Innovation> trigpoint::innovations(const Pictured& seen, const std::vector<Part>& parts,
                                               const Eigen::VectorXd& step,
                                               Eigen::MatrixXd covariance, const double* variances,
                                               const Asked& asked, bool* is_wild) {
    const auto part_of = [&](const Eigen::VectorXd& residual, const Part& part) -> Sighting {
        return {{seen.by_base.data() + 12 * part.first, 2 * part.count, 6},
                {residual.data() + 2 * part.first, 2 * part.count}};
    };
    Eigen::VectorXd left = seen.residual + asked.way * (seen.jacobian * step);
    Eigen::VectorXd good = Eigen::VectorXd::Zero(left.size());
    std::vector<Eigen::VectorXd> weights;
    for (const Part& part : parts) {
        weights.emplace_back();
        tame_step(part_of(left, part), asked.limit, weights.back());
        for (Eigen::Index k = 0; k < part.count; ++k) {
            is_wild[part.first + k] = weights.back()(k) == 0;
            if (weights.back()(k) != 0 && !part.is_wrong)
                good.segment<2>(2 * (part.first + k)).setOnes();
        }
    }
    RowMajor by_state = seen.jacobian;
    if (variances != nullptr) {
        const Stood stood(good.asDiagonal() * seen.by_base, good.cwiseProduct(left),
                          good.asDiagonal() * seen.jacobian, Eigen::Map<const Vector6d>(variances));
        covariance = stood.beside(covariance);
        left += seen.by_base * stood.shift;
        by_state.resize(left.size(), seen.jacobian.cols() + 6);
        by_state << seen.jacobian, seen.by_base;
    }
    std::vector<Innovation> found;
    for (std::size_t v = 0; v < parts.size(); ++v)
        found.push_back(innovation(
            part_of(left, parts[v]), by_state.middleRows(2 * parts[v].first, 2 * parts[v].count),
            weights[v], covariance, asked.room, !parts[v].is_wrong, asked.rest));
    return found;
}
