// What a visit's sightings say of each other: innovations, and the likeliest sets of wrong ones.
#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

template <int R, int C>
using In =
    Eigen::Map<const Eigen::Matrix<double, R, C, C == 1 ? Eigen::ColMajor : Eigen::RowMajor>>;
using Wide = Eigen::Matrix<double, 6, Eigen::Dynamic>;

// A sighting's share of 1 that is left of its pose's variance, at least.
constexpr double LEAST_LEFT = 1e-6;

// Which parts of a visit so far are wrong, and what then is known of the unknowns.
struct Hypothesis {
    double score;
    Eigen::VectorXd mean;
    Eigen::MatrixXd covariance;
    std::vector<bool> wrong;
};

// The hypothesis with one part more, that is right: a Kalman filter's update.
Hypothesis with_right(const Hypothesis& before, const Vector6d& shift, const Matrix6d& own,
                      const Wide& by, double most_room) {
    const Eigen::Matrix<double, Eigen::Dynamic, 6> gain = before.covariance * by.transpose();
    const Matrix6d spread = by * gain + own;
    const Eigen::PartialPivLU<Matrix6d> parts(spread);
    const Matrix6d inverse = parts.inverse();
    const Vector6d error = shift - by * before.mean;
    const double room = parts.matrixLU().diagonal().array().abs().log().sum();
    const Eigen::Matrix<double, Eigen::Dynamic, 6> weighted = gain * inverse;
    Hypothesis after;
    after.score = before.score + error.dot(inverse * error) + std::min(room, most_room);
    after.mean = before.mean + weighted * error;
    after.covariance = before.covariance - weighted * gain.transpose();
    return after;
}

}  // namespace

// (by pose (k, 12), residuals (k, 2), by unknowns (k, 2 q), is wild (k,), covariance (q, q),
// variances of the room (6,), is used, rest, χ² and ln|covariance| (2,)): 1 where the sighting
// determines a pose; see `innovation_excess`.
TRIGPOINT_KERNEL(tp_innovation) {
    const Eigen::Index corners = arguments[0].array.shape[0],
                       unknowns = arguments[4].array.shape[0];
    if (arguments[2].array.shape[1] != 2 * unknowns)
        throw std::invalid_argument("derivatives by other unknowns than the covariance is of");
    Matrix6d information = In<6, 1>(arguments[5].array.as<double>()).cwiseInverse().asDiagonal();
    Vector6d pull = Vector6d::Zero();
    Wide across = Wide::Zero(6, unknowns);
    for (Eigen::Index k = 0; k < corners; ++k) {
        if (arguments[3].array.as<bool>()[k]) continue;
        const In<2, 6> by_pose(arguments[0].array.as<double>() + 12 * k);
        information.noalias() += by_pose.transpose() * by_pose;
        pull.noalias() += by_pose.transpose() * In<2, 1>(arguments[1].array.as<double>() + 2 * k);
        across.noalias() +=
            by_pose.transpose() *
            In<2, Eigen::Dynamic>(arguments[2].array.as<double>() + 2 * unknowns * k, 2, unknowns);
    }
    if (!information.allFinite()) return 0;
    const Eigen::LLT<Matrix6d> known(information);
    if (known.info() != Eigen::Success) return 0;
    const Eigen::LLT<Matrix6d> own(known.solve(Matrix6d::Identity()));
    if (own.info() != Eigen::Success) return 0;
    Wide whitened = across;  // Eigen solves for no column by an address that is none
    if (unknowns > 0) whitened = own.matrixL().solve(known.solve(across));
    const In<Eigen::Dynamic, Eigen::Dynamic> covariance(arguments[4].array.as<double>(), unknowns,
                                                        unknowns);
    const Matrix6d seen = whitened * covariance * whitened.transpose();
    if (!seen.allFinite()) return 0;
    const Eigen::SelfAdjointEigenSolver<Matrix6d> parts(seen);
    const Vector6d step = own.matrixL().solve(-known.solve(pull));
    const double rest = std::sqrt(arguments[7].number);
    const Vector6d pulled =
        ((parts.eigenvectors().transpose() * step).array().abs() - rest).max(0.0).matrix();
    const auto values = parts.eigenvalues().array();
    const bool is_used = arguments[6].whole != 0;
    Vector6d left;
    if (is_used)
        left = (1 - values).max(LEAST_LEFT).min(1.0).matrix();
    else
        left = (1 + values.max(0.0)).matrix();
    const double own_spread = 2 * own.matrixLLT().diagonal().array().log().sum();
    double* found = arguments[8].array.as<double>();
    found[0] = (pulled.array().square() / left.array()).sum();
    found[1] = own_spread + (is_used ? -1 : 1) * left.array().log().sum();
    return 1;
}

// (mean (u,), covariance (u, u), shifts (n, 6), their covariances (n, 6, 6), by unknowns (n, 6, u),
// score of a wrong one, most that ln|covariance| counts, scores (most,), flags (most, n)): how many
// hypotheses were kept, best first; see `likeliest_wrong`.
TRIGPOINT_KERNEL(tp_likeliest_wrong) {
    const auto numbers = [&](int which) { return arguments[which].array.as<double>(); };
    const Eigen::Index unknowns = arguments[0].array.shape[0], parts = arguments[2].array.shape[0];
    const auto most = static_cast<std::size_t>(arguments[7].array.shape[0]);
    using Square = In<Eigen::Dynamic, Eigen::Dynamic>;
    std::vector<Hypothesis> kept(1);
    kept[0] = {
        0, In<Eigen::Dynamic, 1>(numbers(0), unknowns), Square(numbers(1), unknowns, unknowns), {}};
    for (Eigen::Index n = 0; n < parts; ++n) {
        const Vector6d shift = In<6, 1>(numbers(2) + 6 * n);
        const Matrix6d own = In<6, 6>(numbers(3) + 36 * n);
        const Wide by = In<6, Eigen::Dynamic>(numbers(4) + 6 * unknowns * n, 6, unknowns);
        std::vector<Hypothesis> both;
        both.reserve(2 * kept.size());
        for (const Hypothesis& each : kept)
            both.push_back(with_right(each, shift, own, by, arguments[6].number));
        for (std::size_t i = 0; i < kept.size(); ++i) {
            both[i].wrong = kept[i].wrong;
            both[i].wrong.push_back(false);
            both.push_back(std::move(kept[i]));
            both.back().score += arguments[5].number;
            both.back().wrong.push_back(true);
        }
        std::stable_sort(both.begin(), both.end(), [](const Hypothesis& a, const Hypothesis& b) {
            return a.score < b.score;
        });
        if (both.size() > most) both.resize(most);
        kept = std::move(both);
    }
    for (std::size_t i = 0; i < kept.size() && i < most; ++i) {
        numbers(7)[i] = kept[i].score;
        std::copy(kept[i].wrong.begin(), kept[i].wrong.end(),
                  arguments[8].array.as<bool>() + static_cast<Eigen::Index>(i) * parts);
    }
    return static_cast<std::int64_t>(std::min(kept.size(), most));
}
