// How a visit's sightings agree with where single ones put its camera.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Symmetric = Eigen::Map<const Matrix6d>;

// A pair of ways whose positions, or orientations, differ by more than this many sigmas, by the
// traces of their covariances alone, would fail any chi-squared gate by their full covariance too.
constexpr double FAR_SIGMAS = 7;
constexpr double NEVER = std::numeric_limits<double>::infinity();

// What `tp_start_costs` is given, in its order.
enum Given {
    SIGHTINGS,
    PICTURES,
    TURNS,
    PLACES,
    COVARIANCES,
    EXCESS,
    SEEDS,
    ODOMETRY_TURNS,
    ODOMETRY_PLACES,
    DEVIATIONS,
    DRIFT,
    LIMIT,
    MOST_ROOM,
    COSTS
};

double* numbers(const Argument* arguments, Given which) {
    return arguments[which].array.as<double>();
}

const std::int64_t* wholes(const Argument* arguments, Given which) {
    return arguments[which].array.as<std::int64_t>();
}

double shifts(const Symmetric& covariance) { return covariance.topLeftCorner<3, 3>().trace(); }
double turns(const Symmetric& covariance) { return covariance.bottomRightCorner<3, 3>().trace(); }

// One way to read a sighting: camera_from_base, with its covariance in the camera's axes, and what
// is known of the robot in its picture beside that.
struct Way {
    std::int64_t sighting, picture;
    Pose camera_from_base, map_from_base;
    Symmetric covariance, deviation;
    double excess, own_shifts, own_turns, least_room;

    Way(const Argument* arguments, Index index)
        : sighting(wholes(arguments, SIGHTINGS)[index]),
          picture(wholes(arguments, PICTURES)[index]),
          camera_from_base(pose_at(numbers(arguments, TURNS), numbers(arguments, PLACES), index)),
          map_from_base(pose_at(numbers(arguments, ODOMETRY_TURNS),
                                numbers(arguments, ODOMETRY_PLACES), picture)),
          covariance(numbers(arguments, COVARIANCES) + 36 * index),
          deviation(numbers(arguments, DEVIATIONS) + 36 * picture),
          excess(numbers(arguments, EXCESS)[index]),
          own_shifts(shifts(covariance) + shifts(deviation)),
          own_turns(turns(covariance) + turns(deviation)),
          least_room(room(Eigen::LLT<Matrix6d>(covariance))) {}

    // ln|S| of a covariance by its root.
    static double room(const Eigen::LLT<Matrix6d>& root) {
        if (root.info() != Eigen::Success) return -std::numeric_limits<double>::infinity();
        return 2 * root.matrixLLT().diagonal().array().log().sum();
    }
};

// A covariance in the axes that `turn` takes to those that it is in.
Matrix6d turned_back(const Matrix3d& turn, const Matrix6d& covariance) {
    Matrix6d found;
    for (const Index row : {0, 3})
        for (const Index column : {0, 3})
            found.block<3, 3>(row, column) =
                turn.transpose() * covariance.block<3, 3>(row, column) * turn;
    return found;
}

// The covariance of something fixed to what has this one, `arm` away in the same axes: a turn
// swings it.
Matrix6d swung(const Vector3d& arm, const Matrix6d& covariance) {
    const Matrix3d swing = -hat(arm);
    Matrix6d found = covariance;
    found.topRows<3>() += swing * covariance.bottomRows<3>();
    found.leftCols<3>() += found.rightCols<3>() * swing.transpose();
    return found;
}

// A camera where one way puts it. Covariances are in the camera's axes.
class Start {
public:
    // `drift`: of odometry between the seed's picture and each other.
    Start(const Way& seed, const double* drift, Index pictures)
        : seed_(seed),
          camera_(seed.map_from_base.times(seed.camera_from_base.inverse())),
          own_(seed.covariance + turned_back(camera_.rotation, seed.deviation)),
          own_shifts_(2 * seed.own_shifts),
          by_square_(2 * seed.own_turns),
          drift_(drift),
          others_(static_cast<std::size_t>(pictures)),
          is_known_(static_cast<std::size_t>(pictures)) {}

    // What the cost of taking another way to be right, too, is at least: by its position or its
    // orientation alone. Infinite where that is out of question.
    double least_cost(const Way& other, double most_room) const {
        const Symmetric drift = of(other);
        const Vector3d arm = arm_to(other);
        const double variance =
            own_shifts_ + arm.squaredNorm() * by_square_ + other.own_shifts + shifts(drift);
        const Vector3d shift = camera_.rotation * other.camera_from_base.translation +
                               (camera_.translation - other.map_from_base.translation);
        const Matrix3d seen = camera_.rotation * other.camera_from_base.rotation;
        // 2 - 2 cos θ, which is less than θ².
        const double turn = 3 - seen.cwiseProduct(other.map_from_base.rotation).sum(),
                     turn_variance = seed_.own_turns + other.own_turns + turns(drift),
                     pull = std::max(shift.squaredNorm() / variance, turn / turn_variance);
        if (!(pull < FAR_SIGMAS * FAR_SIGMAS)) return NEVER;
        return pull + std::min(other.least_room, most_room) + other.excess;
    }

    // That cost.
    double cost(const Way& other, double most_room) {
        // An error of the seed's own pose swings the robot in the other picture about where it is
        // in the seed's.
        const Matrix6d spread = swung(arm_to(other), own_) + other.covariance + of_picture(other);
        const Eigen::LLT<Matrix6d> root(spread);
        if (root.info() != Eigen::Success) return NEVER;
        Vector6d pull = camera_.times(other.camera_from_base).difference(other.map_from_base);
        pull << camera_.rotation.transpose() * pull.head<3>(),
            camera_.rotation.transpose() * pull.tail<3>();
        root.matrixL().solveInPlace(pull);
        const double cost =
            pull.squaredNorm() + std::min(Way::room(root), most_room) + other.excess;
        return std::isfinite(cost) ? cost : NEVER;
    }

private:
    // What is not known of the robot in another picture, given where it was in the seed's.
    const Matrix6d& of_picture(const Way& other) {
        const auto picture = static_cast<std::size_t>(other.picture);
        if (!is_known_[picture]) {
            others_[picture] = turned_back(camera_.rotation, other.deviation + of(other));
            is_known_[picture] = true;
        }
        return others_[picture];
    }

    Symmetric of(const Way& other) const { return Symmetric(drift_ + 36 * other.picture); }
    Vector3d arm_to(const Way& other) const {
        return other.camera_from_base.translation - seed_.camera_from_base.translation;
    }

    const Way& seed_;
    Pose camera_;
    Matrix6d own_;
    double own_shifts_, by_square_;
    const double* drift_;
    std::vector<Matrix6d> others_;
    std::vector<bool> is_known_;
};

void check(const Argument* arguments) {
    const auto within = [&](Given which, Index end) {
        const std::int64_t* begin = wholes(arguments, which);
        return std::all_of(begin, begin + arguments[which].array.shape[0],
                           [&](std::int64_t value) { return value >= 0 && value < end; });
    };
    const Index pictures = arguments[ODOMETRY_PLACES].array.shape[0];
    if (!within(SIGHTINGS, arguments[COSTS].array.shape[1]) || !within(PICTURES, pictures) ||
        !within(SEEDS, arguments[SIGHTINGS].array.shape[0]))
        throw std::invalid_argument("a sighting, a picture or a way that is none");
}

}  // namespace

// (sightings (n,), pictures (n,), camera_from_base (n, 3, 3), (n, 3), their covariances (n, 6, 6),
// excess χ² (n,), which of these n ways are seeds (s,), map_from_base by odometry (p, 3, 3), (p,
// 3), covariances of deviations from it (p, 6, 6) and of the drift between two (p, p, 36), cost of
// a wrong sighting, most that ln|covariance| counts, costs (s, v)): 0; see `consensus`.
TRIGPOINT_KERNEL(tp_start_costs) {
    check(arguments);
    const Index ways = arguments[SIGHTINGS].array.shape[0], seeds = arguments[SEEDS].array.shape[0],
                pictures = arguments[ODOMETRY_PLACES].array.shape[0],
                sightings = arguments[COSTS].array.shape[1];
    double* costs = numbers(arguments, COSTS);
    std::fill_n(costs, seeds * sightings, arguments[LIMIT].number);
    std::vector<Way> every;
    every.reserve(static_cast<std::size_t>(ways));
    for (Index n = 0; n < ways; ++n) every.emplace_back(arguments, n);
    const double most_room = arguments[MOST_ROOM].number;
    std::vector<double> least(every.size());
    std::vector<std::size_t> likeliest(static_cast<std::size_t>(sightings));
    for (Index s = 0; s < seeds; ++s, costs += sightings) {
        const Way& seed = every[static_cast<std::size_t>(wholes(arguments, SEEDS)[s])];
        Start start(seed, numbers(arguments, DRIFT) + 36 * seed.picture * pictures, pictures);
        const auto look = [&](std::size_t n) {
            double& cost = costs[every[n].sighting];
            if (!(least[n] < cost)) return;
            cost = std::min(cost, start.cost(every[n], most_room));
            least[n] = NEVER;
        };
        std::fill(likeliest.begin(), likeliest.end(), every.size());
        for (std::size_t n = 0; n < every.size(); ++n) {
            const bool is_seed = every[n].sighting == seed.sighting;
            least[n] = is_seed ? NEVER : start.least_cost(every[n], most_room);
            std::size_t& best = likeliest[static_cast<std::size_t>(every[n].sighting)];
            if (best == every.size() || least[n] < least[best]) best = n;
        }
        for (const std::size_t n : likeliest)
            if (n < every.size()) look(n);
        for (std::size_t n = 0; n < every.size(); ++n) look(n);
        costs[seed.sighting] = std::min(0.0, arguments[LIMIT].number);
    }
    return 0;
}
