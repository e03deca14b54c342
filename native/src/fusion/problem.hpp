// The least-squares problem of sightings and odometry, made of tables that Python gives; what its
// unknowns are is said in `fusion/model/problem.py`.
#pragma once

#include <array>
#include <vector>

#include "border.hpp"
#include "fusion/corners.hpp"
#include "fusion/elimination.hpp"

namespace trigpoint {

// What a problem is given as, one after the other (`fusion/solver/tables.py`). A column of -1 says
// that something is not estimated.
enum Given {
    EQUATIONS,
    CAMERA_POSES,       // (c, 12), as all that the state consists of both read and written
    LENSES,             // (c, 12), of which only the camera's parameters count
    CLOCKS,             // (c, 2): offset and drift
    NODES,              // (n, 12)
    FACES,              // (f, 12)
    SCALES,             // (r, 2)
    CAMERAS,            // (c, 4): parameters of the lens; first column of pose, lens, clock
    ROBOTS,             // (r, 8): nodes, motions, faces, in the plane, first node is held; first
                        // column of scales, of faces, of the last node
    MOTIONS,            // (m, 12): between consecutive nodes, as odometry says at the scales
    MOTION_SCALES,      // (r, 2)
    MOTION_COVARIANCE,  // (m, 6, 6)
    MOTION_BY_SCALE,    // (m, 6, 2)
    PICTURES,           // (p, 5): camera, robot, node, corners, whether the robot deviates
    WAYS,               // (p, 12): from the node to the sighting with
    MOMENTS,            // (p, 2): this offset of the clock; and when, since the epoch
    TWISTS,             // (p, 6): of the robot then
    DEVIATIONS,         // (p, 12): variances by which it counts; and in the picture by itself
    CORNER_FACES,       // (k,)
    POINTS,             // (k, 3)
    PIXELS,             // (k, 2)
    WEIGHTS,            // (k,)
    PRIOR_COLUMNS,      // (v,)
    PRIORS,             // (v, 2): expected, variance
    EXPECTED_FACES,     // (f, 12)
    FACE_VARIANCES,     // (f, 6)
    KNOWN_POSES,        // (z,): cameras, and behind all of these the faces
    EXPECTED_POSES,     // (z, 12)
    KNOWN_COLUMNS,      // (w,): of lenses, clocks and scales
    EXPECTED_VALUES,    // (w,)
    KNOWN_INFORMATION,  // (6 z + w, 6 z + w)
    COLUMNS,            // how many the dense part has
    EXACT,              // information of a pose that is known exactly
    HUBER,              // sigmas beyond which a corner's cost is linear
    TOLERANCE,
    MOST_ITERATIONS,
    SCORE  // (4,): cost, iterations, whether it has converged, cost without Huber's
};

// The tables from CAMERA_POSES to SCALES.
using State = std::array<RowMajor, 6>;

// A step of the dense part, and of the inner nodes (d, n) of each chain.
struct Step {
    Eigen::VectorXd dense;
    std::vector<Eigen::MatrixXd> nodes;
};

class Problem {
public:
    // Throws std::invalid_argument where the tables do not fit together, Undetermined where a
    // motion's covariance is not positive definite.
    explicit Problem(const Argument* given);

    State state() const;
    void put(const State& state) const;
    State moved(const State& state, const Step& step) const;
    // Equations of the right shape, and the number of unknowns that are held.
    Equations equations() const;
    Index held() const;
    void linearise(const State& state, double huber, Equations& equations) const;

    // A picture at a state; `faces`: of its robot there.
    Picture picture(const State& state, Index picture, const std::vector<Pose>& faces) const;
    std::vector<Pose> faces(const State& state, Index robot) const;
    // Where the unknowns of a picture's terms are among all, the inner nodes first; of a problem of
    // one robot.
    std::vector<Index> rows_of(Index picture) const;
    // Those of the dense part among them.
    std::vector<Index> columns_of(Index picture) const;
    Index pictures() const { return array(PICTURES).shape[0]; }
    // Whether equations are of its unknowns.
    bool has(const Equations& equations) const;
    // The robot, and its inner node or -1, of a picture.
    Index robot_of(Index picture) const;
    Index inner_node_of(Index picture) const;
    // The term of a motion between nodes at a state, its errors as they are, not in sigmas.
    OdometryTerm motion(const State& state, Index motion) const;
    // Variances (12,) of the robot's deviation in a picture; null where it has none.
    const double* deviation(Index picture) const;

private:
    struct Camera {
        Index lens_parameters;
        Range pose, lens, clock;  // of no columns where they are not estimated
    };
    struct Robot {
        Index first_node, nodes, first_motion, motions, first_face, face_count;
        Tangent tangent;
        bool is_held;
        Range scales, faces, last;
    };
    const Argument* given_;
    Index size_;
    std::vector<Camera> cameras_;
    std::vector<Robot> robots_;
    std::vector<Index> first_corner_;               // of each picture
    std::vector<std::vector<Index>> face_columns_;  // the estimated faces in each picture
    std::vector<AtMost6> white_;                    // of each motion

    const Array& array(int which) const { return given_[which].array; }
    double* numbers(int which) const { return array(which).as<double>(); }
    const std::int64_t* whole(int which, Index row) const;
    Range columns(std::int64_t first, Index count) const;
    void require_rows(int which, Index limit) const;
    void read_cameras();
    void read_robots();
    void read_pictures();
    // The estimated faces of the last picture read; of one that is padded also the first.
    std::vector<Index> faces_in(Index picture) const;

    // The columns of the dense part that a term depends on, as they follow each other in it.
    Ranges of_motion(const Robot& robot, Index motion) const;
    Ranges of_picture(Index picture) const;
    void add_motions(const State& state, std::size_t robot, Equations& equations) const;
    void add_pictures(const State& state, double huber, Equations& equations) const;
    // The first column of an estimated face.
    Index face_column(Index face) const;
    // The values of lenses, clocks and scales in their columns.
    Eigen::VectorXd values(const State& state) const;
    void add_priors(const State& state, Equations& equations) const;
    void add_known(const State& state, Equations& equations) const;
};

}  // namespace trigpoint
