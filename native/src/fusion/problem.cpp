#include "fusion/problem.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace trigpoint {

namespace {

// Columns of CAMERAS, ROBOTS and PICTURES.
enum { LENS_PARAMETERS, POSE_COLUMN, LENS_COLUMN, CLOCK_COLUMN };
enum {
    NODE_COUNT,
    MOTION_COUNT,
    FACE_COUNT,
    IS_PLANAR,
    IS_HELD,
    SCALES_COLUMN,
    FACES_COLUMN,
    LAST_COLUMN
};
enum { CAMERA, ROBOT, NODE, CORNER_COUNT, DEVIATES };

constexpr Index MOST_COLUMNS = 1 << 15, MOST_LENS = 12, NOBODY = -1, KINDS = 6;
constexpr double LEAST_FOCAL_PX = 1;

std::size_t at(Index index) { return static_cast<std::size_t>(index); }

RowMajor& part(State& state, int which) { return state[at(which - CAMERA_POSES)]; }
const RowMajor& part(const State& state, int which) { return state[at(which - CAMERA_POSES)]; }
Pose pose_of(const State& state, int which, Index row) {
    return pose_at(part(state, which).row(row).data());
}

void require(bool is_so) {
    if (!is_so) throw std::invalid_argument("the tables of a problem do not fit together");
}

// The next of several parts of something; all of them must be there.
Index taken(Index& next, std::int64_t count, Index all) {
    require(count >= 0 && count <= all - next);
    return (next += count) - count;
}

// Puts ranges side by side, from `begin` on, without those of no columns.
Ranges side_by_side(Index begin, const Ranges& all) {
    Ranges found;
    for (Range range : all) {
        if (range.count == 0) continue;
        range.at = begin;
        begin += range.count;
        found.push_back(range);
    }
    return found;
}

}  // namespace

Problem::Problem(const Argument* given) : given_(given), size_(given[COLUMNS].whole) {
    require(size_ >= 0 && size_ <= MOST_COLUMNS);
    read_cameras();
    read_robots();
    read_pictures();
    std::vector<Index> owner(at(size_), NOBODY);
    const auto take = [&](Index kind, const Range& range) {
        for (Index k = range.first; k < range.first + range.count; ++k) {
            const Index before = std::exchange(owner[at(k)], KINDS * range.first + kind);
            require(before == NOBODY || before == owner[at(k)]);
        }
    };
    // Cameras may share a lens and a clock; but what one picture depends on lies apart.
    for (const Camera& camera : cameras_)
        take(0, camera.pose), take(1, camera.lens), take(2, camera.clock);
    for (const Robot& robot : robots_)
        take(3, robot.scales), take(4, robot.faces), take(5, robot.last);
    require(std::find(owner.begin(), owner.end(), NOBODY) == owner.end());
    require_rows(PRIOR_COLUMNS, size_);
    require_rows(KNOWN_POSES, array(CAMERAS).shape[0] + array(FACES).shape[0]);
    require_rows(KNOWN_COLUMNS, size_);
    require(array(KNOWN_INFORMATION).shape[0] ==
            6 * array(KNOWN_POSES).shape[0] + array(KNOWN_COLUMNS).shape[0]);
}

const std::int64_t* Problem::whole(int which, Index row) const {
    return array(which).as<std::int64_t>() + std::max<Index>(array(which).shape[1], 1) * row;
}

Range Problem::columns(std::int64_t first, Index count) const {
    require(first >= -1 && first <= size_ - (first < 0 ? 0 : count));
    return first < 0 ? Range{0, 0, 0} : Range{first, count, 0};
}

void Problem::read_cameras() {
    for (Index c = 0; c < array(CAMERAS).shape[0]; ++c) {
        const std::int64_t* camera = whole(CAMERAS, c);
        const Index parameters = camera[LENS_PARAMETERS];
        require(parameters >= 0 && parameters <= MOST_LENS && camera[POSE_COLUMN] >= 0);
        cameras_.push_back({parameters, columns(camera[POSE_COLUMN], 6),
                            columns(camera[LENS_COLUMN], parameters),
                            columns(camera[CLOCK_COLUMN], 2)});
    }
}

void Problem::read_robots() {
    Index node = 0, motion = 0, face = 0;
    for (Index r = 0; r < array(ROBOTS).shape[0]; ++r) {
        const std::int64_t* robot = whole(ROBOTS, r);
        const Index nodes = robot[NODE_COUNT], motions = robot[MOTION_COUNT];
        const Tangent tangent = Tangent::of(robot[IS_PLANAR] != 0);
        require(nodes > 0 && (motions == 0 || motions == nodes - 1) && robot[LAST_COLUMN] >= 0);
        const Index first_node = taken(node, nodes, array(NODES).shape[0]);
        const Index first_motion = taken(motion, motions, array(MOTIONS).shape[0]);
        const Index first_face = taken(face, robot[FACE_COUNT], array(FACES).shape[0]);
        robots_.push_back({first_node, nodes, first_motion, motions, first_face, robot[FACE_COUNT],
                           tangent, robot[IS_HELD] != 0, columns(robot[SCALES_COLUMN], 2),
                           columns(robot[FACES_COLUMN], 6 * robot[FACE_COUNT]),
                           columns(robot[LAST_COLUMN], tangent.count)});
        for (Index m = first_motion; m < motion; ++m)
            white_.push_back(whitening(numbers(MOTION_COVARIANCE) + 36 * m, tangent));
    }
    require(node == array(NODES).shape[0] && motion == array(MOTIONS).shape[0] &&
            face == array(FACES).shape[0]);
}

void Problem::read_pictures() {
    Index corner = 0;
    for (Index p = 0; p < array(PICTURES).shape[0]; ++p) {
        const std::int64_t* picture = whole(PICTURES, p);
        require(picture[CAMERA] >= 0 && picture[CAMERA] < array(CAMERAS).shape[0]);
        require(picture[ROBOT] >= 0 && picture[ROBOT] < array(ROBOTS).shape[0]);
        require(picture[NODE] >= 0 && picture[NODE] < robots_[at(picture[ROBOT])].nodes);
        first_corner_.push_back(taken(corner, picture[CORNER_COUNT], array(POINTS).shape[0]));
        face_columns_.push_back(faces_in(p));
    }
}

std::vector<Index> Problem::faces_in(Index picture) const {
    const std::int64_t* const first = array(CORNER_FACES).as<std::int64_t>() + first_corner_.back();
    const std::int64_t* const end = first + whole(PICTURES, picture)[CORNER_COUNT];
    const Robot& robot = robots_[at(whole(PICTURES, picture)[ROBOT])];
    std::vector<Index> found;
    for (Index face = 0; face < robot.faces.count / 6; ++face)
        if (std::find(first, end, face) != end) found.push_back(face);
    return found;
}

void Problem::require_rows(int which, Index limit) const {
    for (Index row = 0; row < array(which).shape[0]; ++row)
        require(*whole(which, row) >= 0 && *whole(which, row) < limit);
}

State Problem::state() const {
    State found;
    for (int which = CAMERA_POSES; which <= SCALES; ++which)
        part(found, which) = Eigen::Map<const RowMajor>(numbers(which), array(which).shape[0],
                                                        array(which).shape[1]);
    return found;
}

void Problem::put(const State& state) const {
    for (int which = CAMERA_POSES; which <= SCALES; ++which)
        Eigen::Map<RowMajor>(numbers(which), array(which).shape[0], array(which).shape[1]) =
            part(state, which);
}

State Problem::moved(const State& state, const Step& step) const {
    State found = state;
    const auto change = [&](int which, Index row, const auto& pose) {
        put_pose(pose(pose_of(state, which, row)), part(found, which).row(row).data());
    };
    for (std::size_t c = 0; c < cameras_.size(); ++c) {
        const Camera& camera = cameras_[c];
        const Index row = static_cast<Index>(c);
        change(CAMERA_POSES, row, [&](const Pose& pose) {
            return trigpoint::moved(pose, step.dense.segment<6>(camera.pose.first));
        });
        auto lens = part(found, LENSES).row(row).head(camera.lens.count);
        lens += step.dense.segment(camera.lens.first, camera.lens.count).transpose();
        for (Index k = 0; k < std::min<Index>(2, lens.size()); ++k)
            lens[k] = std::max(lens[k], LEAST_FOCAL_PX);
        part(found, CLOCKS).row(row).head(camera.clock.count) +=
            step.dense.segment(camera.clock.first, camera.clock.count).transpose();
    }
    for (std::size_t r = 0; r < robots_.size(); ++r) {
        const Robot& robot = robots_[r];
        for (Index n = 0; n < robot.nodes; ++n) {
            Vector6d by = Vector6d::Zero();
            for (Index k = 0; k < robot.tangent.count; ++k)
                by[robot.tangent.axes[k]] =
                    n + 1 < robot.nodes ? step.nodes[r](k, n) : step.dense[robot.last.first + k];
            change(NODES, robot.first_node + n,
                   [&](const Pose& pose) { return trigpoint::moved(pose, by); });
        }
        part(found, SCALES).row(static_cast<Index>(r)).head(robot.scales.count) +=
            step.dense.segment(robot.scales.first, robot.scales.count).transpose();
        for (Index k = 0; k < robot.faces.count; k += 6)
            change(FACES, robot.first_face + k / 6, [&](const Pose& pose) {
                return pose.disturbed(step.dense.segment<6>(robot.faces.first + k));
            });
    }
    return found;
}

Ranges Problem::of_motion(const Robot& robot, Index motion) const {
    const bool is_to_last = motion + 2 == robot.nodes;
    const Index d = robot.tangent.count;
    Ranges found = side_by_side(2 * d, {robot.scales});
    if (is_to_last) found.push_back({robot.last.first, d, d});
    return found;
}

Ranges Problem::of_picture(Index index) const {
    const std::int64_t* picture = whole(PICTURES, index);
    const Camera& camera = cameras_[at(picture[CAMERA])];
    const Robot& robot = robots_[at(picture[ROBOT])];
    Ranges columns{camera.pose, camera.lens, camera.clock};
    for (const Index face : face_columns_[at(index)])
        columns.push_back({robot.faces.first + 6 * face, 6, 0});
    Ranges found = side_by_side(robot.tangent.count, columns);
    if (picture[NODE] + 1 == robot.nodes) found.push_back(robot.last);
    return found;
}

Equations Problem::equations() const {
    std::vector<Coupled> coupled;
    for (const Robot& robot : robots_) {
        coupled.emplace_back(robot.nodes - 1);
        for (Index m = 0; m < robot.motions; ++m)
            for (const Range& range : of_motion(robot, m)) {
                coupled.back().add(m, range);
                if (m + 2 < robot.nodes) coupled.back().add(m + 1, range);
            }
    }
    for (Index p = 0; p < array(PICTURES).shape[0]; ++p) {
        const std::int64_t* picture = whole(PICTURES, p);
        if (picture[NODE] + 1 < robots_[at(picture[ROBOT])].nodes)
            for (const Range& range : of_picture(p))
                coupled[at(picture[ROBOT])].add(picture[NODE], range);
    }
    Equations found;
    for (std::size_t r = 0; r < robots_.size(); ++r)
        found.chains.emplace_back(robots_[r].tangent.count, std::move(coupled[r]));
    found.dense.resize(size_, size_);
    found.gradient.resize(size_);
    return found;
}

bool Problem::has(const Equations& equations) const {
    const auto is_of = [](const Robot& robot, const ChainEquations& chain) {
        return chain.d == robot.tangent.count && chain.nodes() == robot.nodes - 1;
    };
    return equations.gradient.size() == size_ &&
           std::equal(robots_.begin(), robots_.end(), equations.chains.begin(),
                      equations.chains.end(), is_of);
}

Index Problem::held() const {
    Index count = 0;
    for (const Robot& robot : robots_) count += robot.is_held ? robot.tangent.count : 0;
    return count;
}

void Problem::linearise(const State& state, double huber, Equations& equations) const {
    equations.clear();
    for (std::size_t r = 0; r < robots_.size(); ++r) {
        const Robot& robot = robots_[r];
        add_motions(state, r, equations);
        if (!robot.is_held) continue;
        for (Index k = 0; k < robot.tangent.count; ++k)
            (robot.nodes > 1 ? equations.chains[r].diagonal(k, k)
                             : equations.dense(robot.last.first + k, robot.last.first + k)) +=
                given_[EXACT].number;
    }
    add_pictures(state, huber, equations);
    add_priors(state, equations);
    add_known(state, equations);
}

void Problem::add_motions(const State& state, std::size_t r, Equations& equations) const {
    const Robot& robot = robots_[r];
    const Index own = static_cast<Index>(r);
    const Eigen::Vector2d change =
        part(state, SCALES).row(own) - array(MOTION_SCALES).rows<2>().row(own);
    Eigen::MatrixXd square;
    Eigen::VectorXd pull;
    for (Index m = 0; m < robot.motions; ++m) {
        const Index row = robot.first_motion + m, node = robot.first_node + m;
        const BySteps by_scale = Eigen::Map<const BySteps>(numbers(MOTION_BY_SCALE) + 12 * row);
        const Pose motion = pose_at(numbers(MOTIONS) + 12 * row).disturbed(by_scale * change);
        const OdometryTerm term(pose_of(state, NODES, node), pose_of(state, NODES, node + 1),
                                motion, by_scale, robot.tangent, white_[at(row)]);
        square.noalias() = term.by.transpose() * term.by;
        pull.noalias() = term.by.transpose() * term.residual;
        equations.cost += term.residual.squaredNorm();
        equations.add(equations.chains[r], m, m + 2 < robot.nodes ? 2 : 1, of_motion(robot, m),
                      square, pull);
    }
}

std::vector<Pose> Problem::faces(const State& state, Index robot) const {
    std::vector<Pose> found;
    for (Index f = 0; f < robots_[at(robot)].face_count; ++f)
        found.push_back(pose_of(state, FACES, robots_[at(robot)].first_face + f));
    return found;
}

OdometryTerm Problem::motion(const State& state, Index row) const {
    const auto robot = std::find_if(robots_.begin(), robots_.end(), [&](const Robot& each) {
        return row < each.first_motion + each.motions;
    });
    require(robot != robots_.end());
    const Index node = robot->first_node + row - robot->first_motion;
    return {pose_of(state, NODES, node),
            pose_of(state, NODES, node + 1),
            pose_at(numbers(MOTIONS) + 12 * row),
            Eigen::Map<const BySteps>(numbers(MOTION_BY_SCALE) + 12 * row),
            robot->tangent,
            AtMost6::Identity(robot->tangent.count, robot->tangent.count)};
}

const double* Problem::deviation(Index picture) const {
    return whole(PICTURES, picture)[DEVIATES] != 0 ? numbers(DEVIATIONS) + 12 * picture : nullptr;
}

Index Problem::robot_of(Index picture) const { return whole(PICTURES, picture)[ROBOT]; }

Index Problem::inner_node_of(Index picture) const {
    const Index node = whole(PICTURES, picture)[NODE];
    return node + 1 < robots_[at(robot_of(picture))].nodes ? node : -1;
}

std::vector<Index> Problem::columns_of(Index picture) const {
    const Range& last = robots_[at(robot_of(picture))].last;
    std::vector<Index> found;
    const auto add = [&](const Range& range) {
        for (Index k = 0; k < range.count; ++k) found.push_back(range.first + k);
    };
    if (inner_node_of(picture) < 0) add(last);
    for (const Range& range : of_picture(picture))
        if (range.first != last.first) add(range);
    return found;
}

std::vector<Index> Problem::rows_of(Index picture) const {
    const Robot& robot = robots_.front();
    const Index d = robot.tangent.count, dense = d * (robot.nodes - 1),
                node = inner_node_of(picture);
    std::vector<Index> found;
    for (Index k = 0; node >= 0 && k < d; ++k) found.push_back(d * node + k);
    for (const Index column : columns_of(picture)) found.push_back(dense + column);
    return found;
}

Picture Problem::picture(const State& state, Index p, const std::vector<Pose>& faces) const {
    const std::int64_t* picture = whole(PICTURES, p);
    const Index eye = picture[CAMERA], corner = first_corner_[at(p)];
    const Camera& camera = cameras_[at(eye)];
    const Robot& robot = robots_[at(picture[ROBOT])];
    const Pose node = pose_of(state, NODES, robot.first_node + picture[NODE]);
    const bool has_clock = camera.clock.count > 0;
    const double assumed_s = numbers(MOMENTS)[2 * p], since_s = numbers(MOMENTS)[2 * p + 1];
    const double* twist = numbers(TWISTS) + 6 * p;
    Pose seen = node;
    if (has_clock) {
        const double* clock = part(state, CLOCKS).row(eye).data();
        const double early_s = assumed_s - (clock[0] + clock[1] * since_s);
        seen = node.times(pose_at(numbers(WAYS) + 12 * p)
                              .times(motion_of(early_s * Eigen::Map<const Vector6d>(twist))));
    }
    return {Lens(part(state, LENSES).row(eye).data(), camera.lens_parameters),
            pose_of(state, CAMERA_POSES, eye),
            node,
            seen,
            has_clock ? twist : nullptr,
            since_s,
            faces,
            robot.tangent,
            camera.lens.count > 0,
            face_columns_[at(p)],
            picture[CORNER_COUNT],
            array(CORNER_FACES).as<std::int64_t>() + corner,
            numbers(POINTS) + 3 * corner,
            numbers(PIXELS) + 2 * corner,
            numbers(WEIGHTS) + corner};
}

void Problem::add_pictures(const State& state, double huber, Equations& equations) const {
    std::vector<std::vector<Pose>> all_faces;
    for (std::size_t r = 0; r < robots_.size(); ++r)
        all_faces.push_back(faces(state, static_cast<Index>(r)));
    PictureEquations terms;
    for (Index p = 0; p < array(PICTURES).shape[0]; ++p) {
        const std::int64_t* mine = whole(PICTURES, p);
        terms.set(picture(state, p, all_faces[at(mine[ROBOT])]), deviation(p), huber);
        equations.cost += terms.cost;
        equations.log_determinant += terms.log_determinant;
        equations.add(equations.chains[at(mine[ROBOT])], mine[NODE],
                      mine[NODE] + 1 < robots_[at(mine[ROBOT])].nodes ? 1 : 0, of_picture(p),
                      terms.square, terms.square.rightCols<1>());
    }
}

Eigen::VectorXd Problem::values(const State& state) const {
    Eigen::VectorXd found = Eigen::VectorXd::Zero(size_);
    const auto fill = [&](const Range& range, int which, std::size_t row) {
        found.segment(range.first, range.count) =
            part(state, which).row(static_cast<Index>(row)).head(range.count);
    };
    for (std::size_t c = 0; c < cameras_.size(); ++c) {
        fill(cameras_[c].lens, LENSES, c);
        fill(cameras_[c].clock, CLOCKS, c);
    }
    for (std::size_t r = 0; r < robots_.size(); ++r) fill(robots_[r].scales, SCALES, r);
    return found;
}

void Problem::add_priors(const State& state, Equations& equations) const {
    const Eigen::VectorXd value = values(state);
    const auto add = [&](Index column, double error, double variance) {
        equations.dense(column, column) += 1 / variance;
        equations.gradient[column] += error / variance;
        equations.cost += error * error / variance;
    };
    for (Index v = 0; v < array(PRIOR_COLUMNS).shape[0]; ++v) {
        const Index column = *whole(PRIOR_COLUMNS, v);
        add(column, value[column] - numbers(PRIORS)[2 * v], numbers(PRIORS)[2 * v + 1]);
    }
    for (const Robot& robot : robots_)
        for (Index k = 0; k < robot.faces.count; ++k) {
            const Index face = robot.first_face + k / 6;
            const Vector6d error = pose_of(state, FACES, face)
                                       .difference(pose_at(numbers(EXPECTED_FACES) + 12 * face));
            add(robot.faces.first + k, error[k % 6], numbers(FACE_VARIANCES)[6 * face + k % 6]);
        }
}

// The rotation error e has the derivative ∂Log/∂δθ = J_l⁻¹(e); all others have 1.
void Problem::add_known(const State& state, Equations& equations) const {
    const Index poses = array(KNOWN_POSES).shape[0], single = array(KNOWN_COLUMNS).shape[0];
    const Index size = 6 * poses + single, cameras = array(CAMERAS).shape[0];
    if (size == 0) return;
    Eigen::MatrixXd square = Eigen::Map<const RowMajor>(numbers(KNOWN_INFORMATION), size, size);
    Eigen::VectorXd error(size);
    std::vector<Eigen::Matrix3d> by_turn(at(poses));
    Ranges parts;
    for (Index z = 0; z < poses; ++z) {
        const Index which = *whole(KNOWN_POSES, z), face = which - cameras;
        const Pose now =
            face < 0 ? pose_of(state, CAMERA_POSES, which) : pose_of(state, FACES, face);
        const Vector6d mine = now.difference(pose_at(numbers(EXPECTED_POSES) + 12 * z));
        error.segment<6>(6 * z) = mine;
        by_turn[at(z)] = left_jacobian(mine.tail<3>()).inverse();
        parts.push_back({face < 0 ? cameras_[at(which)].pose.first : face_column(face), 6, 6 * z});
    }
    const Eigen::VectorXd value = values(state);
    for (Index w = 0; w < single; ++w) {
        const Index column = *whole(KNOWN_COLUMNS, w);
        error[6 * poses + w] = value[column] - numbers(EXPECTED_VALUES)[w];
        parts.push_back({column, 1, 6 * poses + w});
    }
    Eigen::VectorXd pull = square * error;
    equations.cost += error.dot(pull);
    for (Index z = 0; z < poses; ++z) {
        const Eigen::Matrix3d& turn = by_turn[at(z)];
        square.middleCols<3>(6 * z + 3) *= turn;
        square.middleRows<3>(6 * z + 3).applyOnTheLeft(turn.transpose());
        pull.segment<3>(6 * z + 3).applyOnTheLeft(turn.transpose());
    }
    equations.add_dense(parts, square, pull);
}

Index Problem::face_column(Index face) const {
    for (const Robot& robot : robots_)
        if (face < robot.first_face + robot.face_count) {
            require(robot.faces.count > 0);
            return robot.faces.first + 6 * (face - robot.first_face);
        }
    throw std::invalid_argument("a problem has no such face");
}

}  // namespace trigpoint
