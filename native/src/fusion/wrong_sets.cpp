// The likeliest sets of wrong sightings of a visit.
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "fusion/linear_visit.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using Wide = Eigen::Matrix<double, 6, Eigen::Dynamic>;

// What `tp_likeliest_wrong` is given after the visit, in its order.
enum Given { SPREAD = LinearVisit::ARGUMENTS, ROOM, WRONG, MOST_ROOM, SCORES, FLAGS };

// Which parts of a visit so far are wrong, and what then is known of the robot's pose at the last
// node (d) and of the others (q).
struct Hypothesis {
    double score;
    VectorXd mean;
    MatrixXd covariance;
    std::vector<bool> wrong;
};

// A hypothesis with one part more, that is right: a Kalman filter's update, prepared.
class Update {
public:
    // The score then; not finite where that cannot be said.
    double prepare(const Hypothesis& before, const Vector6d& shift, const Matrix6d& own,
                   const Wide& by, double most_room) {
        gain_.noalias() = before.covariance * by.transpose();
        Matrix6d spread = own;
        spread.noalias() += by * gain_;
        const Eigen::LLT<Matrix6d> root(spread);
        if (root.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
        pull_ = shift;
        pull_.noalias() -= by * before.mean;
        root.matrixL().solveInPlace(pull_);
        root.matrixU().solveInPlace<Eigen::OnTheRight>(gain_);
        const double room = 2 * root.matrixLLT().diagonal().array().log().sum();
        return before.score + pull_.squaredNorm() + std::min(room, most_room);
    }
    void apply(Hypothesis& after) const {
        after.mean.noalias() += gain_ * pull_;
        after.covariance.noalias() -= gain_ * gain_.transpose();
    }

private:
    // Both times the inverse root of the innovation's covariance.
    Eigen::Matrix<double, Eigen::Dynamic, 6> gain_;
    Vector6d pull_;
};

// Odometry from one node to the next.
class Step {
public:
    Step(const LinearVisit& visit, Index step) : by_(visit.d, visit.d + visit.q) {
        const Eigen::PartialPivLU<MatrixXd> later(visit.by_later(step));
        by_ << visit.by_earlier(step), visit.steps_by_others(step);
        by_ = -later.solve(by_);
        mean_ = later.solve(visit.step(step));
        own_ = later.solve(later.solve(visit.of(SPREAD, step, visit.d, visit.d)).transpose());
    }
    void move(Hypothesis& one) {
        const Index d = mean_.size(), q = by_.cols() - d;
        across_.noalias() = by_ * one.covariance;
        one.mean.head(d) = (by_ * one.mean + mean_).eval();
        one.covariance.topLeftCorner(d, d) = own_ + across_ * by_.transpose();
        one.covariance.topRightCorner(d, q) = across_.rightCols(q);
        one.covariance.bottomLeftCorner(q, d) = across_.rightCols(q).transpose();
    }

private:
    MatrixXd by_, own_, across_;
    VectorXd mean_;
};

// One that is carried on from a hypothesis `before`.
struct Next {
    double score;
    std::size_t before;
    bool is_wrong;
};

}  // namespace

// (visit, covariances of its steps (m, d, d), variances of the room (6,), score of a wrong one,
// most that ln|covariance| counts, scores (most,), flags (most, n)): how many hypotheses were kept,
// best first; see `likeliest_wrong`.
TRIGPOINT_KERNEL(tp_likeliest_wrong) {
    const LinearVisit visit(arguments);
    const Index size = visit.d + visit.q;
    const auto most = static_cast<std::size_t>(arguments[SCORES].array.shape[0]);
    VectorXd information = visit.prior();
    information.head<6>() += visit.of(ROOM, 0, 6, 1).cwiseInverse();
    std::vector<Hypothesis> kept(1), fresh;
    std::vector<Update> updates;
    std::vector<Next> both;
    kept[0] = {0, VectorXd::Zero(size), MatrixXd::Zero(size, size), {}};
    kept[0].covariance.diagonal().tail(visit.q) = information.cwiseInverse();
    Wide by(6, size);
    Index node = 0;
    for (Index n = 0; n < visit.parts; ++n) {
        for (; node < visit.node(n); ++node) {
            Step step(visit, node);
            for (Hypothesis& each : kept) step.move(each);
        }
        by << visit.by_robot(n), visit.by_others(n);
        if (updates.size() < kept.size()) updates.resize(kept.size());
        both.clear();
        for (std::size_t i = 0; i < kept.size(); ++i) {
            const double score = updates[i].prepare(kept[i], visit.shift(n), visit.own(n), by,
                                                    arguments[MOST_ROOM].number);
            if (std::isfinite(score)) both.push_back({score, i, false});
        }
        for (std::size_t i = 0; i < kept.size(); ++i)
            both.push_back({kept[i].score + arguments[WRONG].number, i, true});
        std::stable_sort(both.begin(), both.end(),
                         [](const Next& a, const Next& b) { return a.score < b.score; });
        fresh.resize(std::min(both.size(), most));
        for (std::size_t i = 0; i < fresh.size(); ++i) {
            fresh[i] = kept[both[i].before];
            fresh[i].score = both[i].score;
            fresh[i].wrong.push_back(both[i].is_wrong);
            if (!both[i].is_wrong) updates[both[i].before].apply(fresh[i]);
        }
        std::swap(kept, fresh);
    }
    bool* flags = arguments[FLAGS].array.as<bool>();
    for (std::size_t i = 0; i < std::min(kept.size(), most); ++i) {
        arguments[SCORES].array.as<double>()[i] = kept[i].score;
        flags = std::copy(kept[i].wrong.begin(), kept[i].wrong.end(), flags);
    }
    return static_cast<std::int64_t>(std::min(kept.size(), most));
}
