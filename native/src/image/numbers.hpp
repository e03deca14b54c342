// Small things about a few numbers.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

namespace trigpoint {

// Points or pixels, a row each.
using Points = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
using PointsIn = Eigen::Ref<const Points>;

// The middle one of values, the upper one of two; they are put into another order, and not none.
template <class T>
T median(std::vector<T>& values) {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

}  // namespace trigpoint
