// One round on the way to a mode of a visit: its pictures are read, its problem is solved, and what
// of them is wrong is judged; see `local.LocalProblem`.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "fusion/evidence.hpp"
#include "fusion/minimum.hpp"
#include "fusion/reading.hpp"

using namespace trigpoint;

namespace {

// What `tp_visit_round` is given after `Given`, in its order, each of `Views` a sighting.
enum Rest {
    BODY = SCORE + 1,
    VIEWS = BODY + Body::ARGUMENTS,
    SIGHTING_PICTURES = VIEWS + Views::ARGUMENTS,  // (v,): of which picture each is
    ROWS,                                          // (v,): where its corners begin in POINTS
    CHOSEN,                                        // (v,): the number of the reading of each
    IS_WRONG,                                      // (v,)
    IS_HIDDEN,                                     // (v,): it cannot be seen by any reading
    IS_WILD,                                       // (k,), of all corners of views
    ROOM,                                          // (6,): variances of a pose in the room
    LIMITS,  // (4,): the score of a wild corner, of a wrong sighting, the most that ln|S| counts,
             // the most χ² of a right one's pose
    WORK     // what is to be done, of `Work`
};
enum Work { READ = 1, SOLVE = 2, JUDGE = 4, ROBUST = 8 };
// How a round ends.
enum Ending { NOTHING_FITS, IS_JUDGED_SAME, IS_JUDGED_OTHERWISE };

std::size_t at(Index index) { return static_cast<std::size_t>(index); }

class Visit {
public:
    explicit Visit(const Argument* given)
        : given_(given), body_(given + BODY), views_(given + VIEWS, body_) {
        const Index pictures = array(PICTURES).shape[0], corners = array(POINTS).shape[0];
        if (array(CAMERAS).shape[0] != 1 || array(ROBOTS).shape[0] != 1)
            throw std::invalid_argument("a visit is of one camera and one robot");
        for (Index v = 0; v < views_.count(); ++v) {
            const Index row = whole(ROWS)[v];
            if (whole(SIGHTING_PICTURES)[v] < 0 || whole(SIGHTING_PICTURES)[v] >= pictures ||
                row < 0 || row > corners - views_.corners(v) || whole(CHOSEN)[v] < 0 ||
                whole(CHOSEN)[v] >= views_.readings(v))
                throw std::invalid_argument("a sighting in a picture that is none");
        }
        if (array(FACES).shape[0] != body_.faces())
            throw std::invalid_argument("a robot with other faces");
    }

    // Reads each view as it fits best where camera and robot are; what no reading can show is
    // hidden, and wrong.
    void read() {
        const Lens lens(numbers(LENSES), whole(CAMERAS)[0]);
        const Pose from_map = pose_at(numbers(CAMERA_POSES)).inverse();
        for (Index v = 0; v < views_.count(); ++v) {
            const Index node = whole(PICTURES)[5 * whole(SIGHTING_PICTURES)[v] + 2];
            if (node < 0 || node >= array(NODES).shape[0])
                throw std::invalid_argument("a picture at a node that is none");
            const Pose seen = from_map.times(pose_at(numbers(NODES) + 12 * node));
            const auto [number, rms] = views_.best(v, lens, [&](Index face) -> Pose {
                if (!estimates_faces()) return seen;
                return seen.times(pose_at(numbers(FACES) + 12 * face))
                    .times(body_.face_from_base(face));
            });
            whole(CHOSEN)[v] = number;
            flags(IS_HIDDEN)[v] = !std::isfinite(rms);
            flags(IS_WRONG)[v] |= flags(IS_HIDDEN)[v];
        }
    }

    bool is_all_wrong() const {
        const bool* wrong = flags(IS_WRONG);
        return std::all_of(wrong, wrong + views_.count(), [](bool is) { return is; });
    }

    // Puts the corners into the problem as they are read, without those that are wrong or wild.
    void put_corners() {
        std::fill_n(numbers(WEIGHTS), array(WEIGHTS).shape[0], 0.0);
        for (Index v = 0; v < views_.count(); ++v) {
            const Reading reading = views_.reading(v, whole(CHOSEN)[v]);
            for (Index k = 0; k < views_.corners(v); ++k) {
                const Index row = whole(ROWS)[v] + k;
                Eigen::Map<Eigen::Vector3d>(numbers(POINTS) + 3 * row) =
                    views_.point(v, k, reading);
                whole(CORNER_FACES)[row] = reading.face;
                const bool is_used = !flags(IS_WRONG)[v] && !wild(v)[k];
                numbers(WEIGHTS)[row] = is_used ? 1 / views_.sigma(v) : 0;
            }
        }
    }

    // False where nothing fits.
    bool solve(const Problem& problem, Linearised& linearised) {
        const Found found = minimised(given_, problem, linearised);
        numbers(SCORE)[0] = found.cost;
        numbers(SCORE)[1] = static_cast<double>(found.iterations);
        numbers(SCORE)[2] = found.has_converged;
        numbers(SCORE)[3] = found.plain_cost;
        return std::isfinite(found.cost);
    }

    // Marks the wild corners, and the sightings that are likelier wrong, or right, than taken;
    // whether any is marked otherwise than before. Where the state `is_robust`, minimising the
    // robust cost, only the worst sighting is sure to be wrong.
    bool judge(const Problem& problem, const Linearised& linearised, bool is_robust) {
        System system;
        if (!system.set(linearised)) return false;
        put_weights();
        const std::vector<double> excess = excesses(problem, system, is_robust);
        bool is_other = mark_wild();
        const bool* wrong = flags(IS_WRONG);
        double most = 0;
        std::vector<Index> order;
        for (Index v = 0; v < views_.count(); ++v)
            if (!wrong[v]) {
                order.push_back(v);
                most = std::max(most, excess[at(v)]);
            }
        std::stable_sort(order.begin(), order.end(), [&](Index a, Index b) {
            return excess[at(a)] != excess[at(b)] ? excess[at(a)] > excess[at(b)] : a > b;
        });
        std::vector<bool> is_taken(at(array(PICTURES).shape[0]));
        for (const Index v : order) {
            // Of two sightings that contradict each other in one picture, the other may be right.
            const std::size_t picture = at(whole(SIGHTING_PICTURES)[v]);
            const double least = is_robust ? most : most / 2;
            if (!(excess[at(v)] > 0 && excess[at(v)] >= least) || is_taken[picture]) continue;
            flags(IS_WRONG)[v] = is_taken[picture] = is_other = true;
        }
        if (most > 0) return is_other;
        for (Index v = 0; v < views_.count(); ++v)
            if (wrong[v] && excess[at(v)] < 0 && !flags(IS_HIDDEN)[v]) {
                flags(IS_WRONG)[v] = false;
                is_other = true;
            }
        return is_other;
    }

private:
    const Argument* given_;
    Body body_;
    Views views_;
    std::vector<std::uint8_t> found_wild_;  // of all rows of POINTS

    const Array& array(int which) const { return given_[which].array; }
    double* numbers(int which) const { return array(which).as<double>(); }
    std::int64_t* whole(int which) const { return array(which).as<std::int64_t>(); }
    bool* flags(int which) const { return array(which).as<bool>(); }
    bool* wild(Index view) const { return flags(IS_WILD) + views_.first_corner(view); }
    bool estimates_faces() const { return whole(ROBOTS)[6] >= 0; }

    // Of all corners, including those that are left out.
    void put_weights() {
        for (Index v = 0; v < views_.count(); ++v)
            std::fill_n(numbers(WEIGHTS) + whole(ROWS)[v], views_.corners(v), 1 / views_.sigma(v));
    }

    // By how much each view is less probable than a wrong one, given everything else: against one
    // whose board may be anywhere, and one that is off by any, even a small, amount.
    std::vector<double> excesses(const Problem& problem, const System& system, bool is_robust) {
        const double *limits = numbers(LIMITS), tolerance = given_[TOLERANCE].number;
        // What is left of the way to the minimum is negligible beside the noise, but not beside the
        // residual of a sighting that nearly alone determines an unknown.
        const Asked asked{limits[0], Eigen::Map<const Vector6d>(numbers(ROOM)),
                          is_robust ? 0.0 : 1.0, is_robust ? tolerance : 0.0};
        const State state = problem.state();
        const std::vector<Pose> faces = problem.faces(state, 0);
        std::vector<double> found(at(views_.count()));
        found_wild_.assign(at(array(POINTS).shape[0]), 0);
        Index first = 0;
        for (Index p = 0; p < array(PICTURES).shape[0]; ++p) {
            const Picture picture = problem.picture(state, p, faces);
            std::vector<Index> mine;
            std::vector<Part> parts;
            for (Index v = 0; v < views_.count(); ++v) {
                if (whole(SIGHTING_PICTURES)[v] != p) continue;
                const Index begin = whole(ROWS)[v] - first;
                if (begin < 0 || begin > picture.corners - views_.corners(v))
                    throw std::invalid_argument("a sighting beside its picture");
                mine.push_back(v);
                parts.push_back({begin, views_.corners(v), flags(IS_WRONG)[v]});
            }
            Pictured seen;
            seen.by_base.resize(2 * picture.corners, 6);
            seen.jacobian.resize(2 * picture.corners, picture.columns());
            seen.residual.resize(2 * picture.corners);
            picture.terms(picture.seen, seen.residual, seen.jacobian, seen.by_base);
            const std::vector<Index> rows = problem.rows_of(p);
            std::vector<std::uint8_t> is_wild(at(picture.corners));
            const auto all =
                innovations(seen, parts, system.step(rows), system.covariance(rows, rows),
                            problem.deviation(p), asked, reinterpret_cast<bool*>(is_wild.data()));
            std::copy(is_wild.begin(), is_wild.end(), found_wild_.begin() + first);
            for (std::size_t i = 0; i < mine.size(); ++i) {
                const double over =
                    all[i].chi2 + std::min(all[i].log_spread, limits[2]) - limits[1];
                // What determines no pose cannot contradict anything.
                found[at(mine[i])] =
                    all[i].is_determined ? std::max(over, all[i].chi2 - limits[3]) : -limits[1];
            }
            first += picture.corners;
        }
        return found;
    }

    bool mark_wild() {
        bool is_other = false;
        for (Index v = 0; v < views_.count(); ++v)
            for (Index k = 0; k < views_.corners(v); ++k) {
                const bool is = found_wild_[at(whole(ROWS)[v] + k)] != 0;
                is_other |= is != wild(v)[k];
                wild(v)[k] = is;
            }
        return is_other;
    }
};

}  // namespace

// (a problem as `Given` says, of one camera and one robot, and then what `Rest` says): how the
// round ends. The state and the equations become those of the minimum.
TRIGPOINT_KERNEL(tp_visit_round) {
    const std::int64_t work = arguments[WORK].whole;
    Visit visit(arguments);
    if (work & READ) {
        visit.read();
        if (visit.is_all_wrong()) return NOTHING_FITS;
    }
    visit.put_corners();
    if (!(work & SOLVE)) return IS_JUDGED_SAME;
    auto& linearised = *static_cast<Linearised*>(arguments[EQUATIONS].object);
    try {
        const Problem problem(arguments);
        if (!visit.solve(problem, linearised)) return NOTHING_FITS;
        if (!(work & JUDGE)) return IS_JUDGED_SAME;
        return visit.judge(problem, linearised, (work & ROBUST) != 0) ? IS_JUDGED_OTHERWISE
                                                                      : IS_JUDGED_SAME;
    } catch (const Undetermined&) {
        return NOTHING_FITS;
    }
}
