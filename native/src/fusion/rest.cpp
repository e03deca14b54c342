// A robot's odometry as it comes: without the noise that it shows while the robot stands, and the
// motion from one message to the next. `rest.py` says how it is told that a robot stands,
// `odometry.py` what a track is.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <deque>
#include <optional>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "fusion/motion.hpp"

using namespace trigpoint;

namespace {

constexpr double SECONDS = 1e-9;
constexpr std::int64_t RECENT_NS = 2'000'000'000;  // RECENT_S of `rest.py`
constexpr std::size_t LEAST_READINGS = 16;
// Of √n steps; a random walk comes further within n steps once in a thousand.
constexpr double SCATTERS = 3;
constexpr double DEGREE = 0.017453292519943295;
// Noise that is larger is none of a robot at rest: m, rad.
constexpr double MOST_PLACE = 0.01, MOST_TURN = 1 * DEGREE;
// By how much a gyroscope's heading may creep: ten times the bias of cheap ones (MPU-6050: 30°/h
// after a start), rad/s. No robot turns as slowly.
constexpr double BIAS = 0.1 * DEGREE;
// Over a longer silence than this, and than so many of the intervals before, nothing is noise.
constexpr std::int64_t GAP_NS = 1'000'000'000;  // LONGEST_GAP_S of a track
constexpr double GAP_INTERVALS = 3;
constexpr double GAP_PERIODS = 10, GAP_SHARE = 0.5;
constexpr double ALLOWANCE = 0.05;  // m and rad, for the rounding of stamps

// How far two poses are apart: m, and rad by the chord between their rotations.
struct Apart {
    double place = 0, turn = 0;

    Apart() = default;
    Apart(const Pose& one, const Pose& other)
        : place((one.translation - other.translation).norm()),
          turn((one.rotation - other.rotation).norm() / std::sqrt(2.0)) {}
    bool any() const { return place != 0 || turn != 0; }
};

// A reported pose, and how far it is from the one before.
struct Reading {
    std::int64_t stamp_ns;
    Pose pose;
    Apart step;
};

// What a rest holds, written one value after the other or read again; floats by their bits.
class Cells {
public:
    std::vector<std::int64_t> values;
    std::size_t next = 0;  // to be read
    bool is_read = false;

    void pass(std::int64_t& value) {
        if (!is_read) return values.push_back(value);
        if (next >= values.size()) throw std::invalid_argument("a rest that is cut off");
        value = values[next++];
    }
    void pass(double& value) {
        std::int64_t bits;
        std::memcpy(&bits, &value, sizeof bits);
        pass(bits);
        std::memcpy(&value, &bits, sizeof bits);
    }
    void pass(Apart& apart) {
        pass(apart.place);
        pass(apart.turn);
    }
    void pass(Pose& pose) {
        for (Eigen::Index k = 0; k < 9; ++k) pass(pose.rotation(k));
        for (Eigen::Index k = 0; k < 3; ++k) pass(pose.translation(k));
    }
    void pass(Reading& reading) {
        pass(reading.stamp_ns);
        moment(reading.stamp_ns);
        pass(reading.pose);
        pass(reading.step);
    }
    template <class Value>
    void pass(std::optional<Value>& value) {
        std::int64_t is_there = value.has_value();
        pass(is_there);
        if (is_read) value.reset();
        if (is_read && is_there) value.emplace();
        if (value) pass(*value);
    }
    void pass(std::deque<Reading>& readings) {
        std::int64_t count = static_cast<std::int64_t>(readings.size());
        pass(count);
        if (is_read && (count < 0 || count > static_cast<std::int64_t>(values.size() - next)))
            throw std::invalid_argument("a rest that is cut off");
        readings.resize(static_cast<std::size_t>(count));
        for (Reading& reading : readings) pass(reading);
    }
};

// The pose projected into the plane: position and heading.
Pose in_plane(const Pose& pose) {
    const double forward = pose.rotation(0, 0), left = pose.rotation(1, 0),
                 length = std::hypot(forward, left);
    const double cosine = length > 0 ? forward / length : 1, sine = length > 0 ? left / length : 0;
    Pose flat{Eigen::Matrix3d::Identity(), pose.translation};
    flat.rotation.topLeftCorner<2, 2>() << cosine, -sine, sine, cosine;
    flat.translation.z() = 0;
    return flat;
}

// One robot's reported poses, in order.
class Rest {
public:
    // Whether the robot stands, and its readings show noise.
    bool trembles() const { return anchor_ && noise_.any(); }

    // The pose of a reading, in a frame in which noise at rest has not moved the robot; stamps
    // rise.
    Pose added(std::int64_t stamp_ns, const Pose& pose) {
        const Reading reading = read(stamp_ns, pose);
        if (anchor_ && !has_left(*anchor_, reading)) {
            recent_.push_back(reading);
            return held_;
        }
        if (anchor_) leave();
        recent_.push_back(reading);
        const Pose found = frame_ ? frame_->times(pose) : pose;
        if (const auto noise = noise_at_rest()) {
            anchor_ = reading;
            held_ = found;
            noise_ = *noise;
            recent_ = {reading};
        }
        return found;
    }

    // Writes all that it holds into cells, or takes it from there.
    void pass(Cells& cells) {
        cells.pass(recent_);
        cells.pass(anchor_);
        cells.pass(held_);
        cells.pass(noise_);
        cells.pass(frame_);
        cells.pass(interval_ns_);
        if (anchor_ && recent_.empty()) throw std::invalid_argument("a rest without readings");
    }

private:
    // The reading, after those of the same rest or drive that are recent.
    Reading read(std::int64_t stamp_ns, const Pose& pose) {
        if (recent_.empty()) return {moment(stamp_ns), pose, {}};
        const Reading last = recent_.back();
        const std::int64_t interval_ns = moment(stamp_ns) - last.stamp_ns;
        if (interval_ns > GAP_NS &&
            static_cast<double>(interval_ns) > GAP_INTERVALS * static_cast<double>(interval_ns_)) {
            if (anchor_) {
                recent_ = {last};
                leave();
            }
            recent_.clear();
        }
        while (recent_.size() > 1 && stamp_ns - recent_.front().stamp_ns > RECENT_NS)
            recent_.pop_front();
        interval_ns_ = interval_ns;
        return {stamp_ns, pose, Apart(pose, last.pose)};
    }

    bool has_left(const Reading& anchor, const Reading& reading) const {
        if (!noise_.any()) return reading.step.any();
        const Reading& first = recent_.front();
        const double creep =
            BIAS * SECONDS * static_cast<double>(reading.stamp_ns - first.stamp_ns);
        return !(Apart(reading.pose, anchor.pose).place <= noise_.place &&
                 Apart(reading.pose, first.pose).turn <= noise_.turn + creep);
    }

    // Goes on from where the robot stood. Whatever led away from there was motion; of the turn,
    // only what the last readings show: before that it was a gyroscope's creeping.
    void leave() {
        if (noise_.any())
            frame_ = held_.times(
                Pose{recent_.front().pose.rotation, anchor_->pose.translation}.inverse());
        anchor_.reset();
    }

    // How far noise may take a reading, if all recent ones lie so near; else nothing, since the
    // robot drives, or it cannot be told.
    std::optional<Apart> noise_at_rest() const {
        const Reading &first = recent_.front(), &last = recent_.back();
        const double seconds = SECONDS * static_cast<double>(last.stamp_ns - first.stamp_ns);
        const Apart span(last.pose, first.pose);
        if (!(span.place <= MOST_PLACE && span.turn <= MOST_TURN + BIAS * seconds)) return {};
        if (recent_.size() < LEAST_READINGS || seconds < SECONDS * RECENT_NS / 2) return {};
        // The first and the last steps may be those of a drive, and then say nothing of noise.
        const std::ptrdiff_t quarter = static_cast<std::ptrdiff_t>(recent_.size() / 4);
        double place = 0, turn = 0;
        for (auto each = recent_.begin() + quarter; each != recent_.end() - quarter; ++each) {
            place += each->step.place * each->step.place;
            turn += each->step.turn * each->step.turn;
        }
        Apart noise;
        noise.place = std::min(SCATTERS * std::sqrt(2 * place), MOST_PLACE);
        noise.turn = std::min(SCATTERS * std::sqrt(2 * turn), MOST_TURN);
        const double creep = noise.turn > 0 ? BIAS * seconds : 0;
        for (const Reading& each : recent_) {
            const Apart apart(each.pose, first.pose);
            if (!(apart.place <= noise.place && apart.turn <= noise.turn + creep)) return {};
        }
        return noise;
    }

    std::deque<Reading> recent_;
    std::optional<Reading> anchor_;  // where it came to rest, while it stands
    Pose held_{Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
    Apart noise_;
    std::optional<Pose> frame_;  // of the robot's odometry, in ours
    std::int64_t interval_ns_ = 0;
};

// The motion between two poses as a constant twist, and how far it leads: m, rad.
struct Step {
    Vector6d twist;
    double length, angle;
};

// In the plane t = V v, V = [a -b; b a], a = sin θ/θ, b = (1 - cos θ)/θ.
Step planar_step(const Pose& motion) {
    const double x = motion.translation.x(), y = motion.translation.y(),
                 turn = std::atan2(motion.rotation(1, 0), motion.rotation(0, 0));
    const bool is_small = std::abs(turn) <= 1e-4;
    const double a = is_small ? 1 - turn * turn / 6 : std::sin(turn) / turn,
                 b = is_small ? turn / 2 : (1 - std::cos(turn)) / turn, square = a * a + b * b;
    Step step{Vector6d::Zero(), std::hypot(x, y), std::abs(turn)};
    step.twist << (a * x + b * y) / square, (a * y - b * x) / square, 0, 0, 0, turn;
    return step;
}

Step spatial_step(const Pose& motion) {
    const Eigen::Vector3d turn = log(motion.rotation);
    Step step{Vector6d::Zero(), motion.translation.norm(), turn.norm()};
    step.twist << left_jacobian(turn).partialPivLu().solve(motion.translation), turn;
    return step;
}

// The pose that is given as a rotation and a translation, in the plane where the robot is.
Pose reported(bool is_planar, const Argument* at, Eigen::Index index = 0) {
    const Pose pose = pose_at(at[0].array.as<double>(), at[1].array.as<double>(), index);
    return is_planar ? in_plane(pose) : pose;
}

// A track that grows message by message: the tables of `OdometryTrack`, which have room.
class GrowingTrack {
public:
    static constexpr int ARGUMENTS = 9;
    static constexpr std::int64_t STALE = -1, TAKEN = 0;

    // (how many messages of a standstill are kept, how fast it may drive and turn (2,), messages so
    // far with the last interval and the messages of the standstill (3,), which go on, stamps,
    // rotations, translations, twists, jumps, gaps (n, …)).
    GrowingTrack(Rest& rest, bool is_planar, const Argument* given)
        : rest_(rest),
          is_planar_(is_planar),
          most_standing_(given[0].whole),
          fastest_(given[1].array.as<double>()),
          room_(given[3].array.shape[0]),
          count_(given[2].array.as<std::int64_t>()[0]),
          period_ns_(given[2].array.as<std::int64_t>()[1]),
          standing_(given[2].array.as<std::int64_t>()[2]),
          stamps_(given[3].array.as<std::int64_t>()),
          rotations_(given[4].array.as<double>()),
          translations_(given[5].array.as<double>()),
          twists_(given[6].array.as<double>()),
          jumps_(given[7].array.as<bool>()),
          gaps_(given[8].array.as<double>()) {
        if (count_ < 0 || count_ > room_ || standing_ > MOST_NS)
            throw std::invalid_argument("a track that is none");
        if (count_ > 0) moment(stamps_[count_ - 1]);
    }

    // Takes a message: its row where the motion before it is unknown, else TAKEN, or STALE.
    std::int64_t add(std::int64_t stamp_ns, const Pose& said) {
        const std::int64_t row = count_;
        if (row && stamp_ns <= stamps_[row - 1]) return STALE;
        if (row == room_) throw std::out_of_range("a row beyond the track");
        const Pose pose = rest_.added(stamp_ns, said);
        put_pose(pose, rotations_, translations_, row);
        stamps_[row] = stamp_ns;
        ++count_;
        if (!row) return TAKEN;
        const Pose motion = pose_at(rotations_, translations_, row - 1).inverse().times(pose);
        const Step step = is_planar_ ? planar_step(motion) : spatial_step(motion);
        Eigen::Map<Vector6d>(twists_ + 6 * row) = step.twist;
        const bool is_still = (step.twist.array().abs() < STILL).all();
        const std::int64_t interval_ns = stamp_ns - stamps_[row - 1];
        const bool is_jump = jumps(row, step, SECONDS * static_cast<double>(interval_ns));
        if (is_jump) {
            Eigen::Map<Vector6d>(twists_ + 6 * row).setZero();
            jumps_[row] = true;
        }
        period_ns_ = interval_ns;
        standing_ = is_still && !is_jump ? standing_ + 1 : 0;
        if (standing_ > most_standing_ && row > 1 && stands(row) && stands(row - 1)) {
            stamps_[row - 1] = stamps_[row];  // one step of standing, whose end moves on
            count_ = row;
        }
        return is_jump ? row : TAKEN;
    }

private:
    // Whether the motion in a step is unknown; notes what may have been driven unseen in it.
    bool jumps(std::int64_t row, const Step& step, double seconds) {
        const double usual = SECONDS * static_cast<double>(period_ns_);
        if (row > 1 && seconds > std::max(SECONDS * GAP_NS, GAP_PERIODS * usual)) {
            // If it went on at its speed, the ends are known but not the path between them; if it
            // came much less far, its counters missed some motion or it drove about.
            const double speed =
                Eigen::Map<const Eigen::Vector3d>(twists_ + 6 * (row - 1)).norm() / usual;
            const double reach = speed * seconds;
            gaps_[row] = std::max({reach, step.length, ALLOWANCE});
            if (step.length < GAP_SHARE * reach - ALLOWANCE) return true;
        }
        return step.length > fastest_[0] * seconds + ALLOWANCE ||
               step.angle > fastest_[1] * seconds + ALLOWANCE;
    }

    // Whether the robot is known not to have moved in the step that ends at a row.
    bool stands(std::int64_t row) const {
        const Eigen::Map<const Vector6d> twist(twists_ + 6 * row);
        return !jumps_[row] && gaps_[row] == 0 && (twist.array().abs() < STILL).all();
    }

    Rest& rest_;
    bool is_planar_;
    std::int64_t most_standing_;
    const double* fastest_;
    std::int64_t room_, &count_, &period_ns_, &standing_;
    std::int64_t* stamps_;
    double *rotations_, *translations_, *twists_;
    bool* jumps_;
    double* gaps_;
};

}  // namespace

TRIGPOINT_OBJECT(tp_rest, Rest)

// (the rest, whether the robot is in the plane, stamp, pose as rotation (3, 3) and translation
// (3,), found pose as these): whether the robot trembles.
TRIGPOINT_KERNEL(tp_rest_added) {
    Rest& rest = *static_cast<Rest*>(arguments[0].object);
    const Pose pose = reported(arguments[1].whole, arguments + 3);
    const Pose found = rest.added(arguments[2].whole, pose);
    put_pose(found, arguments[5].array.as<double>(), arguments[6].array.as<double>(), 0);
    return rest.trembles();
}

// (the rest, whether the robot is in the plane, a growing track, stamps (m,), poses as rotations
// (m, 3, 3) and translations (m, 3), the last one that is taken as it was reported (3, 3), (3,),
// what became of each message (m,)): how many were taken.
TRIGPOINT_KERNEL(tp_odometry_added) {
    const bool is_planar = arguments[1].whole;
    GrowingTrack track(*static_cast<Rest*>(arguments[0].object), is_planar, arguments + 2);
    const Argument* given = arguments + 2 + GrowingTrack::ARGUMENTS;
    const auto* stamps = given[0].array.as<std::int64_t>();
    auto* became = given[5].array.as<std::int64_t>();
    std::int64_t taken = 0;
    for (std::int64_t i = 0; i < given[0].array.shape[0]; ++i) {
        const Pose said = reported(is_planar, given + 1, i);
        became[i] = track.add(stamps[i], said);
        if (became[i] == GrowingTrack::STALE) continue;
        put_pose(said, given[3].array.as<double>(), given[4].array.as<double>(), 0);
        ++taken;
    }
    return taken;
}

// (the rest, cells (n,)): how many cells hold it; they are written where they suffice.
TRIGPOINT_KERNEL(tp_rest_saved) {
    Cells cells;
    static_cast<Rest*>(arguments[0].object)->pass(cells);
    const auto count = static_cast<std::int64_t>(cells.values.size());
    if (arguments[1].array.shape[0] >= count)
        std::copy(cells.values.begin(), cells.values.end(), arguments[1].array.as<std::int64_t>());
    return count;
}

// (the rest, cells (n,) as they were saved): 0; it goes on from there.
TRIGPOINT_KERNEL(tp_rest_restored) {
    const auto* values = arguments[1].array.as<std::int64_t>();
    Cells cells{{values, values + arguments[1].array.shape[0]}, 0, true};
    Rest rest;
    rest.pass(cells);
    *static_cast<Rest*>(arguments[0].object) = rest;
    return 0;
}
