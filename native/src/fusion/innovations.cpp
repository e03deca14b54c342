// How far each sighting of a solution is from where everything else predicts it.
#include <limits>
#include <stdexcept>

#include "border.hpp"
#include "fusion/evidence.hpp"
#include "fusion/minimum.hpp"

using namespace trigpoint;

namespace {

// What follows the tables of a problem.
enum { SIGHTINGS = COLUMNS + 1, ROOM, INNOVATIONS };

// The sightings that are asked about.
class Sightings {
public:
    Sightings(const Argument* given, const Problem& problem)
        : given_(given),
          problem_(problem),
          state_(problem.state()),
          how_{std::numeric_limits<double>::infinity(),
               Eigen::Map<const Vector6d>(given[ROOM].array.as<double>()), 1, 0},
          in_picture_(static_cast<std::size_t>(problem.pictures())) {
        for (Index v = 0; v < given[SIGHTINGS].array.shape[0]; ++v) {
            if (sighting(v)[0] < 0 || sighting(v)[0] >= problem.pictures())
                throw std::invalid_argument("a sighting in a picture that is none");
            in_picture_[static_cast<std::size_t>(sighting(v)[0])].push_back(v);
        }
    }

    // Writes the innovations of those of a picture, by the step of its unknowns to the minimum and
    // their covariance.
    void judge(Index p, const Eigen::VectorXd& step, const Eigen::MatrixXd& covariance) const {
        const std::vector<Index>& mine = in_picture_[static_cast<std::size_t>(p)];
        if (mine.empty()) return;
        const std::vector<Pose> faces = problem_.faces(state_, problem_.robot_of(p));
        const Picture picture = problem_.picture(state_, p, faces);
        std::vector<Part> parts;
        for (const Index v : mine) {
            const Index first = sighting(v)[1], count = sighting(v)[2];
            if (first < 0 || count < 0 || first > picture.corners - count)
                throw std::invalid_argument("a sighting beside its picture");
            parts.push_back({first, count, false});
        }
        std::vector<std::uint8_t> is_wild(static_cast<std::size_t>(picture.corners));
        const std::vector<Innovation> found =
            innovations(pictured(picture), parts, step, covariance, problem_.deviation(p), how_,
                        reinterpret_cast<bool*>(is_wild.data()));
        for (std::size_t i = 0; i < mine.size(); ++i) {
            double* written = given_[INNOVATIONS].array.as<double>() + 2 * mine[i];
            written[0] = found[i].is_determined ? found[i].chi2 : 0;
            written[1] = found[i].is_determined ? found[i].log_spread
                                                : -std::numeric_limits<double>::infinity();
        }
    }

private:
    const Argument* given_;
    const Problem& problem_;
    State state_;
    Asked how_;
    std::vector<std::vector<Index>> in_picture_;

    const std::int64_t* sighting(Index v) const {
        return given_[SIGHTINGS].array.as<std::int64_t>() + 3 * v;
    }
};

}  // namespace

// (the equations near a minimum, the state and the problem as `Given` says, and then sightings (v,
// 3): picture, first corner in it, corners; variances (6,) of a pose anywhere in the room; χ² and
// ln |S| (v, 2) of their innovations at the minimum, the latter -inf where one determines no pose):
// 1, or 0 where an unknown is not determined.
TRIGPOINT_KERNEL(tp_innovations) {
    const Problem problem(arguments);
    const Sightings sightings(arguments, problem);
    const auto& linearised = *static_cast<Linearised*>(arguments[EQUATIONS].object);
    return unknowns(
        problem, linearised,
        [&](Index picture, const Eigen::VectorXd& step, const Eigen::MatrixXd& covariance) {
            sightings.judge(picture, step, covariance);
        });
}
