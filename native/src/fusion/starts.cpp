// How a visit's sightings agree with where single ones put its camera.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "border.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Symmetric = Eigen::Map<const Matrix6d>;

// A pair of ways whose positions differ by more than this many sigmas, by the traces of their
// covariances alone, would fail any chi-squared gate by their full covariance too.
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

// One way to read a sighting: camera_from_base, with its covariance in the camera's axes, and what
// is known of the robot in its picture beside that.
struct Way {
    std::int64_t sighting, picture;
    Pose camera_from_base, map_from_base;
    Symmetric covariance, deviation;
    double excess;

    Way(const Argument* arguments, Index index)
        : sighting(wholes(arguments, SIGHTINGS)[index]),
          picture(wholes(arguments, PICTURES)[index]),
          camera_from_base(pose_at(numbers(arguments, TURNS), numbers(arguments, PLACES), index)),
          map_from_base(pose_at(numbers(arguments, ODOMETRY_TURNS),
                                numbers(arguments, ODOMETRY_PLACES), picture)),
          covariance(numbers(arguments, COVARIANCES) + 36 * index),
          deviation(numbers(arguments, DEVIATIONS) + 36 * picture),
          excess(numbers(arguments, EXCESS)[index]) {}
};

// A covariance in other axes.
Matrix6d turned(const Matrix3d& turn, const Matrix6d& covariance) {
    Matrix6d found;
    for (const Index row : {0, 3})
        for (const Index column : {0, 3})
            found.block<3, 3>(row, column) =
                turn * covariance.block<3, 3>(row, column) * turn.transpose();
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

double shifts(const Matrix6d& covariance) { return covariance.topLeftCorner<3, 3>().trace(); }
double turns(const Matrix6d& covariance) { return covariance.bottomRightCorner<3, 3>().trace(); }

// A camera where one way puts it.
class Start {
public:
    explicit Start(const Way& seed)
        : seed_(seed),
          camera_(seed.map_from_base.times(seed.camera_from_base.inverse())),
          own_(turned(camera_.rotation, seed.covariance) + seed.deviation) {}

    // The cost of taking another way to be right, too: infinite where that is out of question.
    double cost(const Way& other, const Symmetric& drift, double most_room) const {
        constexpr double NEVER = std::numeric_limits<double>::infinity();
        const Pose seen = camera_.times(other.camera_from_base);
        const Vector3d arm =
            other.camera_from_base.translation - seed_.camera_from_base.translation;
        const double squared = arm.squaredNorm(),
                     variance = 2 * (shifts(seed_.covariance) + squared * turns(seed_.covariance)) +
                                shifts(other.covariance) + shifts(drift) + other.deviation.trace() +
                                (1 + squared) * seed_.deviation.trace();
        const Vector3d shift = seen.translation - other.map_from_base.translation;
        if (!(shift.squaredNorm() < FAR_SIGMAS * FAR_SIGMAS * variance)) return NEVER;
        // An error of the seed's own pose swings the robot in the other picture about where it is
        // in the seed's. The other way's own covariance is in the axes of the same camera.
        const Matrix6d spread = swung(camera_.rotation * arm, own_) +
                                turned(camera_.rotation, other.covariance) + other.deviation +
                                drift;
        const Eigen::LLT<Matrix6d> root(spread);
        if (root.info() != Eigen::Success) return NEVER;
        const Vector6d pull = root.matrixL().solve(seen.difference(other.map_from_base));
        const double room = 2 * root.matrixLLT().diagonal().array().log().sum(),
                     cost = pull.squaredNorm() + std::min(room, most_room) + other.excess;
        return std::isfinite(cost) ? cost : NEVER;
    }

private:
    const Way& seed_;
    Pose camera_;
    Matrix6d own_;
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
    for (Index s = 0; s < seeds; ++s, costs += sightings) {
        const Way seed(arguments, wholes(arguments, SEEDS)[s]);
        const Start start(seed);
        for (Index n = 0; n < ways; ++n) {
            const Way other(arguments, n);
            if (other.sighting == seed.sighting) continue;
            const Symmetric drift(numbers(arguments, DRIFT) +
                                  36 * (seed.picture * pictures + other.picture));
            const double cost = start.cost(other, drift, arguments[MOST_ROOM].number);
            costs[other.sighting] = std::min(costs[other.sighting], cost);
        }
        costs[seed.sighting] = std::min(0.0, arguments[LIMIT].number);
    }
    return 0;
}
