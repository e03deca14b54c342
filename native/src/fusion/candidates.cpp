// Every way to read the views of a picture, each at the pose of the target that it shows.
#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>

#include "fusion/reading.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;
using Rows3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Rows2 = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;

// The largest reprojection RMS of a candidate. It is generous, since the lens may still be a
// nominal one.
constexpr double WORST_PX = 20;
constexpr double SAME_PLACE_M = 0.05, SAME_TURN_RAD = 0.05;

std::size_t at(Index index) { return static_cast<std::size_t>(index); }

// An interpretation of some views: the number of each one's reading, camera_from_base, and its RMS.
struct Candidate {
    std::vector<Index> readings;
    Pose camera_from_base;
    double rms_px;

    bool is_same(const Candidate& other) const {
        const double cosine =  // 1 + 2 cos(angle)
            camera_from_base.rotation.cwiseProduct(other.camera_from_base.rotation).sum();
        return readings == other.readings && cosine > 1 + 2 * std::cos(SAME_TURN_RAD) &&
               (camera_from_base.translation - other.camera_from_base.translation).norm() <
                   SAME_PLACE_M;
    }
};

// Views of one picture, from one on.
class Picture {
public:
    // `patterns`: of each face, the same where faces cannot be told apart by their corners.
    Picture(const Lens& lens, const Body& body, const std::int64_t* patterns, const Views& views,
            Index first, Index count)
        : lens_(lens),
          body_(body),
          patterns_(patterns),
          views_(views),
          first_(first),
          count_(count) {
        Index all = 0;
        for (Index v = first; v < first + count; ++v) all += views.corners(v);
        pixels_.resize(all, 2);
        weights_.resize(all);
        Index row = 0;
        for (Index v = first; v < first + count; row += views.corners(v++)) {
            pixels_.middleRows(row, views.corners(v)) = views.pixels(v);
            weights_.segment(row, views.corners(v)).setConstant(1 / views.sigma(v));
        }
    }

    // All interpretations, best first.
    std::vector<Candidate> candidates() const {
        for (Index v = first_; v < first_ + count_; ++v) {
            std::vector<Candidate> found = refined(by_view(v));
            if (!found.empty()) return distinct(std::move(found));  // the others took part already
        }
        return {};
    }

    // A candidate's corners in the base frame.
    Rows3 points(const Candidate& candidate) const {
        Rows3 found(pixels_.rows(), 3);
        Index row = 0;
        for (Index i = 0; i < count_; ++i) {
            const Index view = first_ + i;
            const Reading reading = views_.reading(view, candidate.readings[at(i)]);
            const Pose& face = body_.base_from_face(reading.face);
            for (Index k = 0; k < views_.corners(view); ++k)
                found.row(row++) =
                    (face.rotation * views_.point(view, k, reading) + face.translation).transpose();
        }
        return found;
    }

private:
    const Lens& lens_;
    const Body& body_;
    const std::int64_t* patterns_;
    const Views& views_;
    Index first_, count_;
    Rows2 pixels_;
    Eigen::VectorXd weights_;

    // For every reading of one view, the readings of the others that fit best with it.
    std::vector<Candidate> by_view(Index own) const {
        struct Both {
            std::array<Fit, 2> fits;
            std::size_t count;
        };
        std::map<std::int64_t, Both> of_pattern;
        std::vector<Candidate> found;
        for (Index number = 0; number < views_.readings(own); ++number) {
            const Reading reading = views_.reading(own, number);
            const auto [which, is_new] = of_pattern.try_emplace(patterns_[reading.face]);
            Both& both = which->second;
            if (is_new) {
                const Index corners = views_.corners(own);
                Rows3 board(corners, 3);
                for (Index k = 0; k < corners; ++k)
                    board.row(k) =
                        body_.corner({reading.face, false}, views_.id(own, k)).transpose();
                both.count = plane_poses(lens_, Points3(board.data(), corners, 3),
                                         views_.pixels(own), views_.sigma(own), both.fits);
            }
            const Pose pattern_from_base = reading.is_turned ? body_.turned(reading.face).inverse()
                                                             : body_.face_from_base(reading.face);
            for (std::size_t i = 0; i < both.count; ++i) {
                Candidate next{{}, both.fits[i].pose.times(pattern_from_base), 0};
                if (read(own, number, next)) found.push_back(std::move(next));
            }
        }
        return found;
    }

    // Whether the target can be where a candidate has it, one view being read so; its readings.
    bool read(Index own, Index number, Candidate& candidate) const {
        const Pose& pose = candidate.camera_from_base;
        for (Index v = first_; v < first_ + count_; ++v) {
            const auto best =
                v == own
                    ? std::pair(number, views_.rms_px(v, views_.reading(v, number), lens_, pose))
                    : views_.best(v, lens_, [&](Index) -> const Pose& { return pose; });
            if (!std::isfinite(best.second)) return false;
            candidate.readings.push_back(best.first);
        }
        return true;
    }

    // Those that fit, each at its pose of least reprojection error over all views.
    std::vector<Candidate> refined(std::vector<Candidate> reads) const {
        if (reads.empty()) return {};
        const double weight = weights_.mean();
        std::vector<Candidate> found;
        for (Candidate& each : reads) {
            const Rows3 corners = points(each);
            const double rms =
                refine(lens_, each.camera_from_base, Points3(corners.data(), corners.rows(), 3),
                       Pixels(pixels_.data(), pixels_.rows(), 2),
                       Weights(weights_.data(), weights_.size()));
            each.rms_px = rms / weight;
            if (each.rms_px < WORST_PX) found.push_back(std::move(each));
        }
        return found;
    }

    static std::vector<Candidate> distinct(std::vector<Candidate> all) {
        std::stable_sort(all.begin(), all.end(), [](const Candidate& a, const Candidate& b) {
            return a.rms_px < b.rms_px;
        });
        std::vector<Candidate> found;
        for (Candidate& each : all)
            if (std::none_of(found.begin(), found.end(),
                             [&](const Candidate& other) { return each.is_same(other); }))
                found.push_back(std::move(each));
        return found;
    }
};

// What both kernels are given first.
struct Given {
    static constexpr int ARGUMENTS = 2 + Body::ARGUMENTS + Views::ARGUMENTS;
    Lens lens;
    Body body;
    const std::int64_t* patterns;
    Views views;

    explicit Given(const Argument* arguments)
        : lens(arguments[0].array.as<double>(), arguments[0].array.shape[0]),
          body(arguments + 1),
          patterns(arguments[1 + Body::ARGUMENTS].array.as<std::int64_t>()),
          views(arguments + 2 + Body::ARGUMENTS, body) {}
    Picture picture(Index first, Index count) const {
        return {lens, body, patterns, views, first, count};
    }
};

void require_room(Index row, const Array& rows) {
    if (row >= rows.shape[0]) throw std::invalid_argument("more ways to read than rows for them");
}

}  // namespace

// (lens (p,), a body, the pattern of each face (f,), the views of a picture, readings (b, v),
// camera_from_base (b, 12), RMS in pixels (b,)): how many candidates there are, best first; see
// `faces.candidates`.
TRIGPOINT_KERNEL(tp_candidates) {
    const Given given(arguments);
    const Argument* found = arguments + Given::ARGUMENTS;
    const Index count = given.views.count();
    Index row = 0;
    for (const Candidate& each : given.picture(0, count).candidates()) {
        require_room(row, found[0].array);
        std::copy(each.readings.begin(), each.readings.end(),
                  found[0].array.as<std::int64_t>() + count * row);
        put_pose(each.camera_from_base, found[1].array.as<double>() + 12 * row);
        found[2].array.as<double>()[row++] = each.rms_px;
    }
    return row;
}

// (lens (p,), a body, the pattern of each face (f,), views, sigmas of the lens (p,) or none, what
// the faces' mounting adds to a variance of a shift and of a turn, and to that of a shift by an arm
// of a metre (3,), sighting (w,), camera_from_base (w, 12), its covariance (w, 6, 6), excess
// (w,)): how many ways there are to read each view by itself; see `consensus.Ways`.
TRIGPOINT_KERNEL(tp_ways) {
    const Given given(arguments);
    const Argument* found = arguments + Given::ARGUMENTS;
    const Eigen::Map<const Eigen::VectorXd> sigmas(found[0].array.as<double>(),
                                                   found[0].array.shape[0]);
    if (sigmas.size() != 0 && sigmas.size() != given.lens.parameters())
        throw std::invalid_argument("sigmas of another lens");
    const double* mounting = found[1].array.as<double>();
    Index row = 0;
    for (Index v = 0; v < given.views.count(); ++v) {
        const Picture picture = given.picture(v, 1);
        const std::vector<Candidate> all = picture.candidates();
        if (all.empty()) continue;
        const double sigma = given.views.sigma(v), least = all.front().rms_px;
        // Outlying corners or an inexact lens make the fit worse than the corners' stated noise.
        const double scale = std::max(1.0, least / sigma), own = scale * sigma;
        const auto twice = static_cast<double>(2 * given.views.corners(v));
        for (const Candidate& each : all) {
            require_room(row, found[2].array);
            const Rows3 points = picture.points(each);
            const Index face = given.views.reading(v, each.readings[0]).face;
            const double arm2 = given.body.base_from_face(face).translation.squaredNorm();
            Matrix6d covariance =
                covariance_of(given.lens, each.camera_from_base,
                              Points3(points.data(), points.rows(), 3), sigma, sigmas, scale);
            covariance.diagonal().head<3>().array() += mounting[0] + mounting[2] * arm2;
            covariance.diagonal().tail<3>().array() += mounting[1];
            found[2].array.as<std::int64_t>()[row] = v;
            put_pose(each.camera_from_base, found[3].array.as<double>() + 12 * row);
            Eigen::Map<Matrix6d>(found[4].array.as<double>() + 36 * row) = covariance;
            found[5].array.as<double>()[row++] =
                twice * (each.rms_px * each.rms_px - least * least) / (own * own);
        }
    }
    return row;
}
