// A visit's linear equations, the first arguments of what is made of them; see `linear.Linear`.
#pragma once

#include <algorithm>
#include <stdexcept>

#include "border.hpp"

namespace trigpoint {

class LinearVisit {
    using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

public:
    using Index = Eigen::Index;
    using In = Eigen::Map<const Matrix>;
    // Parts, and steps from node to node; unknowns of a node, and those that all may share.
    Index parts, steps, d, q;

    // shifts (n, 6), their covariances (n, 6, 6), nodes (n,), by the robot (n, 6, d), by others
    // (n, 6, q); steps (m, d), by the robot before (m, d, d) and after them (m, d, d), by others
    // (m, d, q); information on others (q,).
    static constexpr int ARGUMENTS = 10;

    explicit LinearVisit(const Argument* arguments)
        : parts(arguments[0].array.shape[0]),
          steps(arguments[5].array.shape[0]),
          d(arguments[5].array.shape[1]),
          q(arguments[9].array.shape[0]),
          arguments_(arguments) {
        if (steps < 1 || d < 1 || q < 6)
            throw std::invalid_argument("a visit of a robot that stands, or of no camera");
        const std::int64_t* nodes = arguments[2].array.as<std::int64_t>();
        if (!std::is_sorted(nodes, nodes + parts) ||
            (parts > 0 && (nodes[0] < 0 || nodes[parts - 1] > steps)))
            throw std::invalid_argument("parts whose nodes do not follow each other");
    }
    Index node(Index part) const { return arguments_[2].array.as<std::int64_t>()[part]; }
    In shift(Index part) const { return of(0, part, 6, 1); }
    In own(Index part) const { return of(1, part, 6, 6); }
    In by_robot(Index part) const { return of(3, part, 6, d); }
    In by_others(Index part) const { return of(4, part, 6, q); }
    In step(Index step) const { return of(5, step, d, 1); }
    In by_earlier(Index step) const { return of(6, step, d, d); }
    In by_later(Index step) const { return of(7, step, d, d); }
    In steps_by_others(Index step) const { return of(8, step, d, q); }
    In prior() const { return of(9, 0, q, 1); }

    // One of many matrices of an argument.
    In of(int argument, Index index, Index rows, Index columns) const {
        return {arguments_[argument].array.as<double>() + rows * columns * index, rows, columns};
    }

private:
    const Argument* arguments_;
};

}  // namespace trigpoint
