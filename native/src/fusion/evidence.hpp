// The innovation of a sighting: how far it is from where everything else predicts it.
#pragma once

#include <vector>

#include "fusion/corners.hpp"
#include "fusion/pose_fitting.hpp"

namespace trigpoint {

// νᵀS⁻¹ν and ln|S| of the pose that a sighting shows by itself.
struct Innovation {
    bool is_determined;
    double chi2, log_spread;
};

// A picture's corners about a state, in sigmas: their derivatives by the robot as it was seen
// (2 k, 6) and by q of the unknowns (2 k, q), and their residuals (2 k,).
struct Pictured {
    ByPoses by_base;
    RowMajor jacobian;
    Eigen::VectorXd residual;
};
Pictured pictured(const Picture& picture);

// One view's corners in its picture, and whether the state was estimated without it.
struct Part {
    Eigen::Index first, count;
    bool is_wrong;
};

// The most χ² of a corner that is not wild; the variances of a pose anywhere in the room; the share
// of the step to the minimum that counts; and the χ² by which the state may still be off it: where
// a sighting determines something nearly alone, that must not count as a contradiction.
struct Asked {
    double limit;
    Vector6d room;
    double way, rest;
};

// The innovations of the views of one picture, given everything else, and which of its corners are
// wild about the pose that their own view shows.
//
// The covariance Σ (q, q) of the unknowns, of which `step` (q,) is left to their minimum, includes
// the sighting itself if it is used. Then, with P the pose's own covariance and H its derivative by
// the unknowns, the residual has the covariance R = P - HΣHᵀ = P S⁻¹ P, and the innovation ν is
// S P⁻¹ times the residual. Where the robot deviates from its node, with `variances` (6,), else
// null, the views constrain each other through the deviation.
std::vector<Innovation> innovations(const Pictured& seen, const std::vector<Part>& parts,
                                    const Eigen::VectorXd& step, Eigen::MatrixXd covariance,
                                    const double* variances, const Asked& asked, bool* is_wild);

}  // namespace trigpoint
