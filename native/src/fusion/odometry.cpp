// One robot's odometry: motion between any of its moments, with its uncertainty; see
// `fusion/model/odometry.py`.
#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/motion.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Square = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

constexpr double NANOSECONDS = 1e9;
// The robot's twist about a moment is taken over so long to either side.
constexpr std::int64_t ABOUT_NS = 2'000'000;
// The variance of a motion that is not known (m², rad²); and what every motion has: keeps the
// information of a tiny one finite.
constexpr double UNKNOWN_VARIANCE = 100.0 * 100.0, FLOOR_VARIANCE = 1e-13;
// The tightest bends that a robot is assumed to have driven in a gap.
constexpr double GAP_RADIUS_M = 0.5;

Vector6d scaled(const Vector6d& twist, const double* scales) {
    Vector6d found = twist;
    found.head<3>() *= 1 + scales[0];
    found.tail<3>() *= 1 + scales[1];
    return found;
}

Vector6d twist_of(const Pose& motion) {
    Vector6d found;
    found.tail<3>() = log(motion.rotation);
    found.head<3>() = left_jacobian(found.tail<3>()).inverse() * motion.translation;
    return found;
}

std::int64_t to_ns(double seconds) {
    const double ns = std::nearbyint(seconds * NANOSECONDS);
    if (!(std::abs(ns) <= static_cast<double>(MOST_NS)))
        throw std::invalid_argument("a span of time that is none");
    return static_cast<std::int64_t>(ns);
}

class Track {
public:
    // Stamps (n,), poses reported (n, 3, 3), (n, 3), twists (n, 6) of the increment that ends with
    // each, whether the motion in it is unknown (n,), path that may have been driven unseen (n,).
    static constexpr int ARGUMENTS = 6;

    explicit Track(const Argument* given)
        : given_(given),
          stamps_(given[0].array.as<std::int64_t>()),
          count_(given[0].array.shape[0]) {
        if (count_ < 2) throw std::invalid_argument("odometry of one message shows no motion");
        if (!std::is_sorted(stamps_, stamps_ + count_, std::less_equal<>()))
            throw std::invalid_argument("odometry that is not in order of time");
        moment(stamps_[0]);
        moment(stamps_[count_ - 1]);
    }

    // The motion from a moment during seconds, and the twist at the end. Beyond the odometry's
    // ends, and across a jump, its last motion is extrapolated.
    Pose carried(std::int64_t from_ns, double during_s, const double* scales,
                 Vector6d& twist) const {
        const std::int64_t end_ns = from_ns + to_ns(during_s);
        const Index start = row(from_ns), last = row(end_ns);
        const Index end = jumps_between(start, last) ? start : last;
        const double after_s = seconds(from_ns - stamps_[end - 1]) + during_s;
        const Pose before = within(start, seconds(from_ns - stamps_[start - 1]));
        const Pose between = before.inverse().times(within(end, after_s));
        twist = scaled(twist_at(end), scales) / period_s(end);
        // A stretch this short may be scaled as a whole.
        return motion_of(scaled(twist_of(between), scales));
    }

    // The mean twist about a moment, but not across a jump.
    Vector6d twist_about(std::int64_t stamp_ns) const {
        std::int64_t before = stamp_ns - ABOUT_NS, after = stamp_ns + ABOUT_NS;
        if (is_jump_in(before, stamp_ns)) before = stamp_ns;
        if (is_jump_in(stamp_ns, after)) after = stamp_ns;
        after = std::max(after, before + 1);
        const double scales[2] = {0, 0}, during_s = seconds(after - before);
        Vector6d last;
        return twist_of(carried(before, during_s, scales, last)) / during_s;
    }

    // Calls for each part of a message's increment between two moments: its row, and its share.
    template <class Step>
    void steps(std::int64_t from_ns, std::int64_t to_ns, Step&& step) const {
        for (std::int64_t now = from_ns; now < to_ns;) {
            const std::int64_t* next = std::upper_bound(stamps_, stamps_ + count_, now);
            const std::int64_t end = next < stamps_ + count_ ? std::min(to_ns, *next) : to_ns;
            const Index at = row(end);
            step(at, static_cast<double>(end - now) /
                         static_cast<double>(stamps_[at] - stamps_[at - 1]));
            now = end;
        }
    }

    Vector6d twist_at(Index row) const {
        return Eigen::Map<const Vector6d>(given_[3].array.as<double>() + 6 * row);
    }
    bool is_unknown(Index row) const { return given_[4].array.as<bool>()[row]; }
    // Whether a step adds neither motion nor noise.
    bool is_at_rest(Index row) const {
        return !is_unknown(row) && gap_m(row) == 0 && twist_at(row).isZero(0);
    }
    double gap_m(Index row) const { return given_[5].array.as<double>()[row]; }

private:
    const Argument* given_;
    const std::int64_t* stamps_;
    Index count_;

    // Of the message that ends the increment in which a moment lies.
    Index row(std::int64_t stamp_ns) const {
        const Index found = std::lower_bound(stamps_, stamps_ + count_, stamp_ns) - stamps_;
        return std::clamp<Index>(found, 1, count_ - 1);
    }
    static double seconds(std::int64_t ns) { return static_cast<double>(ns) / NANOSECONDS; }
    double period_s(Index row) const { return seconds(stamps_[row] - stamps_[row - 1]); }

    // Whether the pose is that of another piece after one of two messages than after the other.
    bool jumps_between(Index first, Index second) const {
        const bool* jumps = given_[4].array.as<bool>();
        return std::find(jumps + std::min(first, second) + 1, jumps + std::max(first, second) + 1,
                         true) != jumps + std::max(first, second) + 1;
    }
    // Whether a step that jumps ends after one moment and by another.
    bool is_jump_in(std::int64_t from_ns, std::int64_t to_ns) const {
        const std::int64_t* begin = std::upper_bound(stamps_, stamps_ + count_, from_ns);
        const std::int64_t* end = std::upper_bound(stamps_, stamps_ + count_, to_ns);
        const bool* jumps = given_[4].array.as<bool>();
        return std::find(jumps + (begin - stamps_), jumps + (end - stamps_), true) !=
               jumps + (end - stamps_);
    }
    // odom_from_base so long after the message before a row, by the row's twist.
    Pose within(Index row, double since_s) const {
        // A row's own pose, not the one before it: a jump lies between those.
        const double left = (since_s - period_s(row)) / period_s(row);
        const Pose end = pose_at(given_[1].array.as<double>(), given_[2].array.as<double>(), row);
        return end.times(motion_of(twist_at(row) * left));
    }
};

// The noise of odometry: the contract's random walk, and slip and skid (m per √rad turned) along
// both axes of the plane and along the track alone.
struct Noise {
    // Distance, lateral, vertical; heading by distance, by turn; tilt by distance, by turn.
    Vector3d by_length, turn_by_length, turn_by_turn;
    double slip, skid;

    Noise(const double* parts, double of_slip, double of_skid)
        : by_length(squared(parts[0], parts[1], parts[2])),
          turn_by_length(squared(parts[5], parts[5], parts[3])),
          turn_by_turn(squared(parts[6], parts[6], parts[4])),
          slip(of_slip * of_slip),
          skid(of_skid * of_skid) {}

private:
    static Vector3d squared(double x, double y, double z) { return {x * x, y * y, z * z}; }
};

// A step's frame and end in those of a motion's start; its own covariance, of its shift and its
// turn, and its derivative by the heading's scale, in its frame's axes.
struct Part {
    Matrix3d frame;
    Vector3d end;
    Matrix3d shift;
    Vector3d turn, bend, turning;
};

// A motion composed of small steps, with its covariance and its derivative by the scales.
struct Motion {
    Pose whole{Matrix3d::Identity(), Vector3d::Zero()};
    Square covariance = FLOOR_VARIANCE * Square::Identity();
    BySteps by_scale = BySteps::Zero();
    bool is_still = true;

    Motion(const Track& track, std::int64_t from_ns, std::int64_t to_ns, const Noise& noise,
           const double* scales) {
        std::vector<Part> parts;
        track.steps(from_ns, to_ns, [&](Index row, double share) {
            if (!track.is_at_rest(row)) parts.push_back(next(track, row, share, noise, scales));
        });
        for (const Part& part : parts) add(part);
        by_scale.col(0).head<3>() = whole.translation / (1 + scales[0]);
    }

private:
    Part next(const Track& track, Index row, double share, const Noise& noise,
              const double* scales) {
        const Vector6d twist = track.twist_at(row) * share, driven = scaled(twist, scales);
        const Pose step = motion_of(driven);
        const double unseen = track.gap_m(row) * share;
        const double length = std::max(twist.head<3>().norm(), unseen),
                     turned = std::max(twist.tail<3>().norm(), unseen / GAP_RADIUS_M);
        Part part;
        part.frame = whole.rotation;
        whole = whole.times(step);
        part.end = whole.translation;
        // d(k J_l(kθ) v)/dk = Exp(kθ) v, so a step's own translation J_l(kθ) v bends with its turn.
        part.bend = (step.rotation * driven.head<3>() - step.translation) / (1 + scales[1]);
        part.turning = twist.tail<3>();
        is_still &= twist.cwiseAbs().maxCoeff() < STILL && !track.is_unknown(row);
        if (track.is_unknown(row)) {
            part.shift = UNKNOWN_VARIANCE * Matrix3d::Identity();
            part.turn.setConstant(UNKNOWN_VARIANCE);
            return part;
        }
        Vector3d along = length * noise.by_length;
        along.x() += turned * noise.skid;
        const Matrix3d middle = exp(0.5 * twist.tail<3>());
        part.shift = middle * along.asDiagonal() * middle.transpose();
        part.shift.diagonal().head<2>().array() += turned * noise.slip;
        part.turn = length * noise.turn_by_length + turned * noise.turn_by_turn;
        return part;
    }

    // A turn of a step swings what lies ahead.
    void add(const Part& part) {
        const Matrix3d swing = -hat(whole.translation - part.end);
        const Matrix3d shift = part.frame * part.shift * part.frame.transpose();
        const Matrix3d turn = part.frame * part.turn.asDiagonal() * part.frame.transpose();
        const Matrix3d across = swing * turn;
        covariance.topLeftCorner<3, 3>() += shift + across * swing.transpose();
        covariance.topRightCorner<3, 3>() += across;
        covariance.bottomLeftCorner<3, 3>() += across.transpose();
        covariance.bottomRightCorner<3, 3>() += turn;
        const Vector3d turning = part.frame * part.turning;
        by_scale.col(1).head<3>() += part.frame * part.bend + swing * turning;
        by_scale.col(1).tail<3>() += turning;
    }
};

}  // namespace

// (a track, moments (m,), seconds (m,), scales (2,), the motion (m, 12), the twist at its end
// (m, 6)): 0; see `OdometryTrack.carried`.
TRIGPOINT_KERNEL(tp_carried) {
    const Track track(arguments);
    const Argument* asked = arguments + Track::ARGUMENTS;
    for (Index m = 0; m < asked[0].array.shape[0]; ++m) {
        Vector6d twist;
        put_pose(track.carried(moment(asked[0].array.as<std::int64_t>()[m]),
                               asked[1].array.as<double>()[m], asked[2].array.as<double>(), twist),
                 asked[3].array.as<double>() + 12 * m);
        Eigen::Map<Vector6d>(asked[4].array.as<double>() + 6 * m) = twist;
    }
    return 0;
}

// (a track, moments (m,), twists (m, 6)): 0; see `OdometryTrack.twists_about`.
TRIGPOINT_KERNEL(tp_twists_about) {
    const Track track(arguments);
    const Argument* asked = arguments + Track::ARGUMENTS;
    for (Index m = 0; m < asked[0].array.shape[0]; ++m)
        Eigen::Map<Vector6d>(asked[1].array.as<double>() + 6 * m) =
            track.twist_about(moment(asked[0].array.as<std::int64_t>()[m]));
    return 0;
}

// (a track, moments (m,), the noise's parts (7,), slip, skid, scales (2,), the motion between them
// (n, 12), its covariance (n, 6, 6), by the scales (n, 6, 2), whether there is none (n,)): 0, of
// n = m - 1 motions; see `OdometryTrack.motion`.
TRIGPOINT_KERNEL(tp_motion) {
    const Track track(arguments);
    const Argument* asked = arguments + Track::ARGUMENTS;
    const Index count = asked[5].array.shape[0];
    if (asked[0].array.shape[0] != count + 1)
        throw std::invalid_argument("one motion fewer than moments");
    const std::int64_t* moments = asked[0].array.as<std::int64_t>();
    const Noise noise(asked[1].array.as<double>(), asked[2].number, asked[3].number);
    for (Index n = 0; n < count; ++n) {
        const Motion found(track, moment(moments[n]), moment(moments[n + 1]), noise,
                           asked[4].array.as<double>());
        put_pose(found.whole, asked[5].array.as<double>() + 12 * n);
        Eigen::Map<Square>(asked[6].array.as<double>() + 36 * n) = found.covariance;
        Eigen::Map<BySteps>(asked[7].array.as<double>() + 12 * n) = found.by_scale;
        asked[8].array.as<bool>()[n] = found.is_still;
    }
    return 0;
}

namespace {

// A motion as Python asks for one: a track, two moments, the noise's parts (7,), slip, skid, scales
// (2,); returns it and the arguments that follow.
Motion asked_motion(const Argument*& arguments) {
    const Track track(arguments);
    const Argument* asked = arguments + Track::ARGUMENTS;
    arguments = asked + 6;
    return {track, moment(asked[0].whole), moment(asked[1].whole),
            Noise(asked[2].array.as<double>(), asked[3].number, asked[4].number),
            asked[5].array.as<double>()};
}

}  // namespace

// (a motion's arguments, a pose (1, 12) at its start and its covariance (6, 6), the pose at its end
// (1, 12) and its covariance (6, 6)): 0. A rotation of the start swings the end about it.
TRIGPOINT_KERNEL(tp_carried_on) {
    const Argument* asked = arguments;
    const Motion motion = asked_motion(asked);
    const Pose start = pose_at(asked[0].array.as<double>()), end = start.times(motion.whole);
    const Eigen::Map<const Square> before(asked[1].array.as<double>());
    Matrix6d by_start = Matrix6d::Identity(), by_motion = Matrix6d::Zero();
    by_start.topRightCorner<3, 3>() = -hat(end.translation - start.translation);
    by_motion.topLeftCorner<3, 3>() = by_motion.bottomRightCorner<3, 3>() = start.rotation;
    put_pose(end, asked[2].array.as<double>());
    Eigen::Map<Square>(asked[3].array.as<double>()) =
        by_start * before * by_start.transpose() +
        by_motion * motion.covariance * by_motion.transpose();
    return 0;
}

// (a motion's arguments, the pose (1, 12) at its start and that at its end, about which it is
// linear, the free directions (d,), matrix (d, d + 2), shift (d,), noise (d, d)): 1, or 0 where a
// covariance is not positive definite. The disturbance of the end is the matrix times that of the
// start and the scales' change, plus the shift and noise of that covariance: with the whitened
// residual e + J₀ δ₀ + J₁ δ₁ + Jₛ δₛ it is -J₁⁻¹ (e + J₀ δ₀ + Jₛ δₛ), of covariance J₁⁻¹ J₁⁻ᵀ.
TRIGPOINT_KERNEL(tp_odometry_step) {
    const Argument* asked = arguments;
    const Motion motion = asked_motion(asked);
    const Tangent tangent(asked[2].array.as<std::int64_t>(), asked[2].array.shape[0]);
    const Index d = tangent.count;
    if (asked[3].array.shape[1] != d + 2) throw std::invalid_argument("a step has two scales");
    try {
        const OdometryTerm term(pose_at(asked[0].array.as<double>()),
                                pose_at(asked[1].array.as<double>()), motion.whole, motion.by_scale,
                                tangent, whitening(motion.covariance.data(), tangent));
        const AtMost6 inverse = term.by.middleCols(d, d).inverse();
        Eigen::Map<RowMajor> matrix(asked[3].array.as<double>(), d, d + 2);
        matrix.leftCols(d) = -inverse * term.by.leftCols(d);
        matrix.rightCols(2) = -inverse * term.by.rightCols(2);
        Eigen::Map<Eigen::VectorXd>(asked[4].array.as<double>(), d) = -inverse * term.residual;
        Eigen::Map<RowMajor>(asked[5].array.as<double>(), d, d) = inverse * inverse.transpose();
    } catch (const Undetermined&) {
        return 0;
    }
    return 1;
}
