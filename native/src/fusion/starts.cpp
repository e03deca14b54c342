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
    double excess, own_shifts, own_turns;

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
          own_turns(turns(covariance) + turns(deviation)) {}
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

    // The cost of taking another way to be right, too: infinite where that is out of question.
    double cost(const Way& other, double most_room) {
        constexpr double NEVER = std::numeric_limits<double>::infinity();
        const Symmetric drift(drift_ + 36 * other.picture);
        const Vector3d arm =
            other.camera_from_base.translation - seed_.camera_from_base.translation;
        const double variance = own_shifts_ + arm.squaredNorm() * by_square_ + other.own_shifts +
                                shifts(drift);
        const Vector3d shift = camera_.rotation * other.camera_from_base.translation +
                               (camera_.translation - other.map_from_base.translation);
        if (!(shift.squaredNorm() < FAR_SIGMAS * FAR_SIGMAS * variance)) return NEVER;
        const Matrix3d seen = camera_.rotation * other.camera_from_base.rotation;
        const double squared_turn = 3 - seen.cwiseProduct(other.map_from_base.rotation).sum(),
                     turn_variance = seed_.own_turns + other.own_turns + turns(drift);
        if (!(squared_turn < FAR_SIGMAS * FAR_SIGMAS * turn_variance)) return NEVER;
        // An error of the seed's own pose swings the robot in the other picture about where it is
        // in the seed's.
        const Matrix6d spread = swung(arm, own_) + other.covariance + of_picture(other, drift);
        const Eigen::LLT<Matrix6d> root(spread);
        if (root.info() != Eigen::Success) return NEVER;
        Vector6d pull = camera_.times(other.camera_from_base).difference(other.map_from_base);
        pull << camera_.rotation.transpose() * pull.head<3>(),
            camera_.rotation.transpose() * pull.tail<3>();
        root.matrixL().solveInPlace(pull);
        const double room = 2 * root.matrixLLT().diagonal().array().log().sum(),
                     cost = pull.squaredNorm() + std::min(room, most_room) + other.excess;
        return std::isfinite(cost) ? cost : NEVER;
    }

private:
    // What is not known of the robot in another picture, given where it was in the seed's.
    const Matrix6d& of_picture(const Way& other, const Symmetric& drift) {
        const auto picture = static_cast<std::size_t>(other.picture);
        if (!is_known_[picture]) {
            others_[picture] = turned_back(camera_.rotation, other.deviation + drift);
            is_known_[picture] = true;
        }
        return others_[picture];
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
    for (Index s = 0; s < seeds; ++s, costs += sightings) {
        const Way& seed = every[static_cast<std::size_t>(wholes(arguments, SEEDS)[s])];
        Start start(seed, numbers(arguments, DRIFT) + 36 * seed.picture * pictures, pictures);
        for (const Way& other : every) {
            if (other.sighting == seed.sighting) continue;
            const double cost = start.cost(other, arguments[MOST_ROOM].number);
            costs[other.sighting] = std::min(costs[other.sighting], cost);
        }
        costs[seed.sighting] = std::min(0.0, arguments[LIMIT].number);
    }
    return 0;
}
