// One round on the way to a mode of a visit: its pictures are read, its problem is solved, and what
// of them is wrong is judged; see `local.LocalProblem`.
#include <Eigen/Eigenvalues>
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
    WORK,    // what is to be done, of `Work`
    END_OF_VISIT
};
// What `tp_visit_linear` is given after them: see `linear.Linear`.
enum Linear {
    BY_PICTURES = END_OF_VISIT,  // whether the parts are pictures, otherwise views
    PARTS,                       // (n,): which of them each is
    PART_NODES,                  // (n,)
    SHIFTS,                      // (n, 6)
    OWN,                         // (n, 6, 6)
    BY_ROBOT,                    // (n, 6, d)
    BY_OTHERS,                   // (n, 6, q)
    STEPS,                       // (m, d)
    BY_EARLIER,                  // (m, d, d)
    BY_LATER,                    // (m, d, d)
    STEPS_BY_OTHERS              // (m, d, q)
};
// A pose is not determined if the least eigenvalue of its scaled information is below this.
constexpr double FLAT = 1e-12, LEAST_SCALE = 1e-9;
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
        if (whole(CAMERAS)[0] < 0 || whole(CAMERAS)[0] > array(LENSES).shape[1])
            throw std::invalid_argument("a lens with more parameters than there are");
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
    // robust cost, only the worst sighting is sure to be wrong, and not a lone one that wild
    // corners still pull at: what alone determines an unknown looks far off for a small pull.
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
        if (is_robust && order.size() == 1 && has_wild(order[0])) return is_other;
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

    // The shift of the robot's pose that each part by itself asks for, and the odometry between
    // nodes, linearised about the state: how many parts determine a pose. Pictures are without what
    // is wrong or wild; views that are not wrong, without what is wild of each by itself.
    Index linearise(const Problem& problem) {
        const bool by_pictures = given_[BY_PICTURES].whole != 0;
        if (!by_pictures) put_weights();
        const State state = problem.state();
        const std::vector<Pose> faces = problem.faces(state, 0);
        Index kept = 0, first = 0;
        for (Index p = 0; p < array(PICTURES).shape[0]; ++p) {
            const Picture picture = problem.picture(state, p, faces);
            const Pictured seen = pictured(picture);
            if (by_pictures) {
                kept += part(seen, picture.face_columns, p, p, kept);
            } else {
                for (Index v = 0; v < views_.count(); ++v)
                    if (whole(SIGHTING_PICTURES)[v] == p && !flags(IS_WRONG)[v])
                        kept += part(tame(seen, begin(v, first, picture), views_.corners(v)),
                                     picture.face_columns, v, p, kept);
            }
            first += picture.corners;
        }
        for (Index m = 0; m < array(STEPS).shape[0]; ++m) step(problem.motion(state, m), m);
        return kept;
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
    bool has_wild(Index view) const {
        return std::any_of(wild(view), wild(view) + views_.corners(view),
                           [](bool is) { return is; });
    }
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
                mine.push_back(v);
                parts.push_back({begin(v, first, picture), views_.corners(v), flags(IS_WRONG)[v]});
            }
            const Pictured seen = pictured(picture);
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

    // Where a view's corners begin in their picture, which begins at `first` of all.
    Index begin(Index view, Index first, const Picture& picture) const {
        const Index found = whole(ROWS)[view] - first;
        if (found < 0 || found > picture.corners - views_.corners(view))
            throw std::invalid_argument("a sighting beside its picture");
        return found;
    }

    // One view's corners without those that are wild by itself.
    Pictured tame(const Pictured& picture, Index first, Index count) const {
        Pictured seen{picture.by_base.middleRows(2 * first, 2 * count),
                      picture.jacobian.middleRows(2 * first, 2 * count),
                      picture.residual.segment(2 * first, 2 * count)};
        Eigen::VectorXd weight;
        tame_step({{seen.by_base.data(), 2 * count, 6}, {seen.residual.data(), 2 * count}},
                  numbers(LIMITS)[0], weight);
        for (Index k = 0; k < count; ++k)
            if (weight(k) == 0) {
                seen.by_base.middleRows<2>(2 * k).setZero();
                seen.jacobian.middleRows<2>(2 * k).setZero();
                seen.residual.segment<2>(2 * k).setZero();
            }
        return seen;
    }

    // Columns of the camera's own unknowns, and of the robot's scales, in a linear visit.
    Index own_columns() const {
        const std::int64_t* camera = whole(CAMERAS);
        return 6 + (camera[2] >= 0 ? camera[0] : 0) + (camera[3] >= 0 ? 2 : 0);
    }
    Index scale_columns() const { return whole(ROBOTS)[5] >= 0 ? 2 : 0; }

    // One of many matrices of an argument.
    Eigen::Map<RowMajor> matrix(int which, Index index) const {
        const auto& shape = array(which).shape;
        const Index columns = std::max<Index>(shape[2], 1);
        return {numbers(which) + shape[1] * columns * index, shape[1], columns};
    }

    // Writes a part, in whose columns some faces are, as the next that is kept: 1, or 0 where it
    // determines no pose.
    Index part(const Pictured& seen, const std::vector<Index>& shown, Index number, Index picture,
               Index row) const {
        const Matrix6d information = seen.by_base.transpose() * seen.by_base;
        if (!information.allFinite()) return 0;
        const Vector6d scale = information.diagonal().cwiseMax(LEAST_SCALE).array().rsqrt();
        const Eigen::SelfAdjointEigenSolver<Matrix6d> parts(scale.asDiagonal() * information *
                                                            scale.asDiagonal());
        if (!(parts.eigenvalues()(0) >= FLAT)) return 0;
        const Matrix6d root = scale.asDiagonal() * parts.eigenvectors() *
                              parts.eigenvalues().array().rsqrt().matrix().asDiagonal();
        const Matrix6d covariance = root * root.transpose();
        const Eigen::Matrix<double, 6, Eigen::Dynamic> by =
            covariance * (seen.by_base.transpose() * seen.jacobian);
        const Index d = array(BY_ROBOT).shape[2], q = array(BY_OTHERS).shape[2],
                    own = own_columns(), faces = own + scale_columns();
        if (row >= array(PARTS).shape[0] ||
            d + own + 6 * static_cast<Index>(shown.size()) != by.cols() ||
            q != faces + (estimates_faces() ? 6 * array(FACES).shape[0] : 0))
            throw std::invalid_argument("parts of other unknowns");
        whole(PARTS)[row] = number;
        whole(PART_NODES)[row] = whole(PICTURES)[5 * picture + 2];
        matrix(SHIFTS, row) = -(covariance * (seen.by_base.transpose() * seen.residual));
        matrix(OWN, row) = covariance;
        matrix(BY_ROBOT, row) = by.leftCols(d);
        auto by_others = matrix(BY_OTHERS, row);
        by_others.setZero();
        by_others.leftCols(own) = by.middleCols(d, own);
        for (std::size_t i = 0; i < shown.size(); ++i)
            by_others.middleCols<6>(faces + 6 * shown[i]) =
                by.middleCols<6>(d + own + 6 * static_cast<Index>(i));
        return 1;
    }

    void step(const OdometryTerm& term, Index row) const {
        const Index d = term.residual.size(), own = own_columns(), scales = scale_columns();
        if (array(STEPS).shape[1] != d || own + scales > array(STEPS_BY_OTHERS).shape[2])
            throw std::invalid_argument("steps of other unknowns");
        matrix(STEPS, row) = -term.residual;
        matrix(BY_EARLIER, row) = term.by.leftCols(d);
        matrix(BY_LATER, row) = term.by.middleCols(d, d);
        auto by_others = matrix(STEPS_BY_OTHERS, row);
        by_others.setZero();
        by_others.middleCols(own, scales) = term.by.middleCols(2 * d, scales);
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

// (what `tp_visit_round` is given, and then what `Linear` says): how many parts of the visit
// determine a pose.
TRIGPOINT_KERNEL(tp_visit_linear) {
    if (arguments[STEPS].array.shape[0] != arguments[MOTIONS].array.shape[0])
        throw std::invalid_argument("other steps than motions");
    Visit visit(arguments);
    visit.put_corners();
    return visit.linearise(Problem(arguments));
}
