// What quadrilaterals show where a marker has its cells.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "image/numbers.hpp"
#include "markers/quads.hpp"

namespace trigpoint {

// What markers have in their cells, a marker each column.
using Templates = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Reads the values of a picture at places (c, 2) in the unit square of quads.
class CellReader {
public:
    // `least`: the standard deviation of what is seen.
    CellReader(const Grey& grey, const PointsIn& places, double least);
    // The values (c,) in a quad, their mean taken away and of length 1; 0, and false, where they
    // are too much alike.
    bool read(const Quad& quad, Eigen::Ref<Eigen::VectorXd> cells);

private:
    Grey grey_;
    PointsIn places_;
    double least_;
    std::vector<float> xs_, ys_, values_;

    bool locate(const Quad& quad);
};

// The quad in a row of eight numbers, from its corner `first` on.
template <class Row>
Quad quad_of(const Row& row, int first = 0) {
    Quad quad;
    for (int k = 0; k < 4; ++k) quad[k] = row.template segment<2>(2 * ((first + k) % 4));
    return quad;
}

}  // namespace trigpoint
