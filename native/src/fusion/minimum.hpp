// The minimum of a least-squares problem, and what its equations there tell of the unknowns.
#pragma once

#include <functional>

#include "fusion/problem.hpp"

namespace trigpoint {

// The equations of least squares where a minimum was looked for last.
struct Linearised {
    Equations equations;
    double log_held = 0;  // ln |information| of what is held exactly
};

// How a minimum was found: its cost, and that without Huber's.
struct Found {
    double cost, plain_cost;
    std::int64_t iterations;
    bool has_converged;
};

// The minimum of a problem given as `Given` says, whose state becomes that of the minimum, and the
// equations there. Throws Undetermined where a motion is not determined, std::invalid_argument.
Found minimised(const Argument* given, const Problem& problem, Linearised& linearised);

// Hands over each picture's unknowns, in the order of its derivatives: their step to the minimum,
// and their covariance there, by the equations of the problem near it; false where an unknown is
// not determined. Throws std::invalid_argument where they are not that problem's.
using TakeUnknowns =
    std::function<void(Index, const Eigen::VectorXd& step, const Eigen::MatrixXd& covariance)>;
bool unknowns(const Problem& problem, const Linearised& linearised, const TakeUnknowns& take);

// The inverse of the whole.
struct System {
    Eigen::MatrixXd covariance;  // of all unknowns, the inner nodes first
    Eigen::VectorXd step;        // to the minimum
    double log_determinant = 0;  // of the information, without what is held

    // False where an unknown is not determined or the cost is not finite.
    bool set(const Linearised& linearised);
};

}  // namespace trigpoint
