// How improbable a visit is under a noise model: its restricted likelihood, with derivatives.
//
// The unknowns are the robot's poses at the visit's nodes, a chain, and a border: the camera and
// others, and the floor's tilt wherever the robot stood.
#include <Eigen/LU>
#include <cmath>
#include <optional>

#include "fusion/bordered_chain.hpp"
#include "fusion/linear_visit.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

// Places closer than this (m) are one.
constexpr double SAME_PLACE = 1e-3;

// What `tp_misfit` is given after the visit, in its order.
enum Given {
    PLACES = LinearVisit::ARGUMENTS,
    BY_ODOMETRY,
    BY_SLIP,
    BROKEN,
    JITTER,
    TILT,
    LENGTH,
    ODOMETRY,
    SLIP,
    VALUE,
    BY_NOISE,
    SAVED
};

// The prior of the floor's tilt, two slopes at every place: a Gaussian process in the plane.
class Floor {
public:
    Floor(const MatrixXd& apart, double tilt, double length)
        : precision_(1 / (tilt * tilt)), correlation_((-apart / length).array().exp()) {
        const Index places = apart.rows();
        const Eigen::LLT<MatrixXd> root(correlation_);
        by_length_ = correlation_.cwiseProduct(apart) / length;
        inverse_ = root.solve(MatrixXd::Identity(places, places));
        log_determinant = 4 * (root.matrixLLT().diagonal().array().log().sum() +
                               static_cast<double>(places) * std::log(tilt));
    }
    double log_determinant;  // of the slopes' covariance
    Index places() const { return inverse_.rows(); }

    void add_to(Eigen::Ref<MatrixXd> information) const {
        each([&](Index row, Index column, Index i, Index j) {
            information(row, column) += precision_ * inverse_(i, j);
        });
    }
    // The χ² of the slopes found (2 t,), with their covariance (2 t, 2 t), and the derivatives of
    // the misfit by the logarithms of tilt and length.
    Eigen::Vector3d judged(const VectorXd& found, const MatrixXd& covariance) const {
        double chi2 = 0;
        MatrixXd moment = MatrixXd::Zero(inverse_.rows(), inverse_.cols());
        each([&](Index row, Index column, Index i, Index j) {
            chi2 += precision_ * found(row) * inverse_(i, j) * found(column);
            moment(i, j) += precision_ * (covariance(row, column) + found(row) * found(column));
        });
        const MatrixXd by_correlation = 2 * inverse_ - inverse_ * moment * inverse_;
        return {chi2, 2 * correlation_.cwiseProduct(by_correlation).sum(),
                by_length_.cwiseProduct(by_correlation).sum()};
    }

private:
    // All pairs of slopes along the same axis, and the places that they are at.
    template <class Work>
    void each(Work&& work) const {
        for (Index i = 0; i < inverse_.rows(); ++i)
            for (Index j = 0; j < inverse_.rows(); ++j)
                for (Index axis = 0; axis < 2; ++axis) work(2 * i + axis, 2 * j + axis, i, j);
    }
    double precision_;
    MatrixXd correlation_, inverse_, by_length_;
};

// A visit under a noise model.
template <int D>
class Misfit {
    using Block = Eigen::Matrix<double, D, D>;

public:
    Misfit(const LinearVisit& visit, const Argument* arguments)
        : visit_(visit),
          arguments_(arguments),
          jitter_(visit.of(JITTER, 0, 6, 1)),
          shifts_(visit.parts),
          steps_(visit.steps) {
        if (number(LENGTH) > 0) {
            jitter_.segment<2>(3).setZero();  // the floor's
            floor_.emplace(place(), number(TILT), number(LENGTH));
        }
        chain_.emplace(visit.steps, visit.q, floor_ ? floor_->places() : 0);
        for (Index i = 0; i < visit.parts; ++i) add_shift(shifts_[i], i);
        for (Index i = 0; i < visit.steps; ++i) add_step(steps_[i], i);
        chain_->border().diagonal().head(visit.q) += visit.prior();
        if (!floor_) return;
        const Index slopes = 2 * floor_->places();
        floor_->add_to(chain_->border().bottomRightCorner(slopes, slopes));
        value_ += floor_->log_determinant;
    }

    // Writes what `tp_misfit` does; whether the visit determines it.
    bool judge() {
        if (!chain_->solve()) return false;
        const auto shared = chain_->border_solution().head(visit_.q);
        value_ += chain_->log_determinant() + shared.cwiseAbs2().dot(visit_.prior().col(0));
        const Vector6d by_jitter = judge_shifts();
        const Vector2d by_steps = judge_steps();
        // A floor leaves the heading's share of the tilt as it is.
        double by_tilt = by_jitter.tail<3>().sum(), by_length = 0;
        if (floor_) {
            const Index slopes = 2 * floor_->places();
            const Vector3d found =
                floor_->judged(chain_->border_solution().tail(slopes),
                               chain_->border_covariance().bottomRightCorner(slopes, slopes));
            value_ += found(0);
            by_tilt = found(1);
            by_length = found(2);
        }
        *numbers(VALUE) = value_;
        Eigen::Map<Eigen::Matrix<double, 5, 1>> by_noise(numbers(BY_NOISE));
        by_noise << by_tilt, by_jitter.head<3>().sum(), by_length, by_steps;
        return std::isfinite(value_) && by_noise.allFinite();
    }

private:
    double* numbers(Given which) const { return arguments_[which].array.as<double>(); }
    double number(Given which) const { return arguments_[which].number; }
    Block block(Given which, Index step) const { return visit_.of(which, step, D, D); }
    Vector2d weights() const {
        return {number(ODOMETRY) * number(ODOMETRY), number(SLIP) * number(SLIP)};
    }

    // Puts each part at a place; the distances between these.
    MatrixXd place() {
        const LinearVisit::In positions = visit_.of(PLACES, 0, visit_.parts, 3);
        std::vector<Index> first;
        for (Index i = 0; i < visit_.parts; ++i) {
            const auto is_there = [&](Index other) {
                return (positions.row(other) - positions.row(i)).norm() < SAME_PLACE;
            };
            const auto found = std::find_if(first.begin(), first.end(), is_there);
            shifts_[i].place = found - first.begin();
            if (found == first.end()) first.push_back(i);
        }
        const Index places = static_cast<Index>(first.size());
        MatrixXd apart(places, places);
        for (Index i = 0; i < places; ++i)
            for (Index j = 0; j < places; ++j)
                apart(i, j) = (positions.row(first[i]) - positions.row(first[j])).norm();
        return apart;
    }
    void add_shift(Equation<6, D>& each, Index i) {
        each.later = visit_.node(i) - 1;  // the first is held
        each.columns.setZero(6, 2 * D + visit_.q + 3);
        if (each.later != HELD) each.columns.template middleCols<D>(D) = visit_.by_robot(i);
        each.columns.middleCols(2 * D, visit_.q) = visit_.by_others(i);
        if (floor_) each.columns.template block<2, 2>(3, 2 * D + visit_.q).setIdentity();
        each.columns.template rightCols<1>() = visit_.shift(i);
        Matrix6d covariance = visit_.own(i);
        covariance.diagonal() += jitter_;
        add(each, covariance);
    }
    void add_step(Equation<D, D>& each, Index i) {
        each.earlier = i - 1;
        each.later = i;
        each.columns.setZero(D, 2 * D + visit_.q + 3);
        if (i) each.columns.template leftCols<D>() = visit_.by_earlier(i);
        each.columns.template middleCols<D>(D) = visit_.by_later(i);
        each.columns.middleCols(2 * D, visit_.q) = visit_.steps_by_others(i);
        each.columns.template rightCols<1>() = visit_.step(i);
        add(each, weights()(0) * block(BY_ODOMETRY, i) + weights()(1) * block(BY_SLIP, i) +
                      block(BROKEN, i));
    }
    template <int R>
    void add(Equation<R, D>& each, const typename Equation<R, D>::Square& covariance) {
        each.whiten(covariance);
        chain_->add(each);
        value_ += each.log_determinant();
    }

    // The derivatives by the logarithms of the jitter's six standard deviations.
    Vector6d judge_shifts() {
        Vector6d by = Vector6d::Zero(), left;
        for (const auto& each : shifts_) {
            const Matrix6d known = chain_->known(each, left);
            value_ += left.squaredNorm();
            by += each.by_covariance(known, left).diagonal();
        }
        return 2 * jitter_.cwiseProduct(by);
    }
    // The derivatives by the logarithms of odometry's noise and slip.
    Vector2d judge_steps() {
        Vector2d by(0, 0);
        Eigen::Matrix<double, D, 1> left;
        for (Index i = 0; i < visit_.steps; ++i) {
            const Block known = chain_->known(steps_[i], left);
            value_ += left.squaredNorm();
            const Block by_covariance = steps_[i].by_covariance(known, left);
            by += Vector2d(by_covariance.cwiseProduct(block(BY_ODOMETRY, i)).sum(),
                           by_covariance.cwiseProduct(block(BY_SLIP, i)).sum());
            const Block room = (1 + ROUNDING) * Block::Identity() - known;
            numbers(SAVED)[i] = left.dot(room.partialPivLu().solve(left));
        }
        return 2 * weights().cwiseProduct(by);
    }

    const LinearVisit& visit_;
    const Argument* arguments_;
    Vector6d jitter_;
    std::optional<Floor> floor_;
    std::vector<Equation<6, D>> shifts_;
    std::vector<Equation<D, D>> steps_;
    std::optional<BorderedChain<D>> chain_;
    double value_ = 0;
};

}  // namespace

// (visit, where its parts were (n, 3), covariances of its steps by noise, by slip and by what broke
// (m, d, d), jitter (6,), tilt, length, odometry, slip; misfit (1,), its derivatives by the
// logarithms of tilt, sway, length, odometry, slip (5,), χ² without each step (m,)): whether the
// visit determines it; see `misfit`.
TRIGPOINT_KERNEL(tp_misfit) {
    const LinearVisit visit(arguments);
    if (visit.d == 3) return Misfit<3>(visit, arguments).judge();
    if (visit.d == 6) return Misfit<6>(visit, arguments).judge();
    throw std::invalid_argument("a robot that moves neither in the plane nor in space");
}
