#include "fusion/elimination.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <utility>

namespace trigpoint {

void Coupled::add(Index node, const Range& range) {
    Ranges& mine = of[static_cast<std::size_t>(node)];
    const auto at = std::lower_bound(mine.begin(), mine.end(), range);
    if (at == mine.end() || range < *at) mine.insert(at, range);
}

void Coupled::lay_out(Index more) {
    begins.assign(1, 0);
    for (Ranges& ranges : of) {
        Index width = 0;
        for (Range& range : ranges) {
            range.at = width;
            width += range.count;
        }
        begins.push_back(begins.back() + width + more);
    }
}

Index place(const Ranges& ranges, const Range& range) {
    return std::lower_bound(ranges.begin(), ranges.end(), range)->at;
}

ChainEquations::ChainEquations(Index unknowns, Coupled with)
    : d(unknowns), coupled(std::move(with)) {
    const Index n = static_cast<Index>(coupled.of.size());
    coupled.lay_out(0);
    diagonal.resize(d, n * d);
    lower.resize(d, n * d);
    gradient.resize(d, n);
    coupling.resize(d, coupled.begin(n));
}

void Equations::clear() {
    for (ChainEquations& chain : chains)
        for (auto* part : {&chain.diagonal, &chain.lower, &chain.gradient, &chain.coupling})
            part->setZero();
    dense.setZero();
    gradient.setZero();
    cost = log_determinant = 0;
}

void Equations::add(ChainEquations& chain, Index node, Index inner, const Ranges& parts,
                    const Eigen::Ref<const Eigen::MatrixXd>& square,
                    const Eigen::Ref<const Eigen::VectorXd>& pull) {
    const Index d = chain.d;
    for (Index k = 0; k < inner; ++k) {
        const Index at = node + k;
        chain.diagonal.middleCols(d * at, d) += square.block(d * k, d * k, d, d);
        chain.gradient.col(at) += pull.segment(d * k, d);
        for (const Range& part : parts)
            chain.coupling.middleCols(chain.coupled.begin(at) + place(chain.coupled[at], part),
                                      part.count) += square.block(d * k, part.at, d, part.count);
    }
    if (inner == 2) chain.lower.middleCols(d * node, d) += square.block(d, 0, d, d);
    add_dense(parts, square, pull);
}

void Equations::add_dense(const Ranges& parts, const Eigen::Ref<const Eigen::MatrixXd>& square,
                          const Eigen::Ref<const Eigen::VectorXd>& pull) {
    for (const Range& row : parts) {
        gradient.segment(row.first, row.count) += pull.segment(row.at, row.count);
        for (const Range& column : parts)
            dense.block(row.first, column.first, row.count, column.count) +=
                square.block(row.at, column.at, row.count, column.count);
    }
}

bool factorised(Eigen::Ref<Eigen::MatrixXd> matrix) {
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> root(matrix);
    return root.info() == Eigen::Success && (matrix.diagonal().array() > 0).all();
}

Elimination::Elimination(const ChainEquations& chain) : d_(chain.d), filled_(chain.coupled) {
    const Index n = chain.nodes();
    for (Index reach = 1; reach <= n; reach *= 2)
        for (Index node = reach - 1; node < n; node += 2 * reach) {
            const Order next{node, node - reach, node + reach < n ? node + reach : -1};
            order_.push_back(next);
            for (const Index neighbour : {next.left, next.right})
                if (neighbour >= 0)
                    for (const Range& range : filled_[node]) filled_.add(neighbour, range);
        }
    filled_.lay_out(2 * d_ + 1);
    factor_.resize(d_, d_ * n);
    rows_.resize(d_, filled_.begin(n));
}

bool Elimination::eliminate(const ChainEquations& chain, double damping,
                            Eigen::MatrixXd& information, Eigen::VectorXd& gradient) {
    const Index d = d_, n = chain.nodes();
    factor_ = chain.diagonal;
    rows_.setZero();
    for (Index i = 0; i < n; ++i) {
        factor_.middleCols(d * i, d).diagonal() *= 1 + damping;
        auto mine = rows(i);
        if (i > 0) mine.leftCols(d) = chain.lower.middleCols(d * (i - 1), d);
        for (const Range& range : chain.coupled[i])
            mine.middleCols(2 * d + place(filled_[i], range), range.count) =
                chain.coupling.middleCols(chain.coupled.begin(i) + range.at, range.count);
        mine.rightCols<1>() = chain.gradient.col(i);
    }
    Eigen::MatrixXd square;
    for (const Order& next : order_) {
        auto factor = factor_.middleCols(d * next.node, d);
        if (!factorised(factor)) return false;
        auto mine = rows(next.node);
        if (next.right >= 0) mine.middleCols(d, d) = rows(next.right).leftCols(d).transpose();
        factor.triangularView<Eigen::Lower>().solveInPlace(mine);
        const auto own = mine.rightCols(mine.cols() - 2 * d);
        const Index last = own.cols() - 1;
        square.noalias() = own.transpose() * own;
        const Ranges& ranges = filled_[next.node];
        for (const Range& row : ranges) {
            gradient.segment(row.first, row.count) -= square.col(last).segment(row.at, row.count);
            for (const Range& column : ranges)
                information.block(row.first, column.first, row.count, column.count) -=
                    square.block(row.at, column.at, row.count, column.count);
        }
        const auto by_left = mine.leftCols(d), by_right = mine.middleCols(d, d);
        if (next.left >= 0) onto(next.left, ranges, by_left, own);
        if (next.right >= 0) onto(next.right, ranges, by_right, own);
        if (next.left >= 0 && next.right >= 0)
            rows(next.right).leftCols(d) = -by_right.transpose() * by_left;
    }
    return true;
}

void Elimination::onto(Index neighbour, const Ranges& ranges,
                       const Eigen::Ref<const Eigen::MatrixXd>& across,
                       const Eigen::Ref<const Eigen::MatrixXd>& own) {
    factor_.middleCols(d_ * neighbour, d_).noalias() -= across.transpose() * across;
    const Eigen::MatrixXd shared = across.transpose() * own;
    auto theirs = rows(neighbour);
    for (const Range& range : ranges)
        theirs.middleCols(2 * d_ + place(filled_[neighbour], range), range.count) -=
            shared.middleCols(range.at, range.count);
    theirs.rightCols<1>() -= shared.rightCols<1>();
}

void Elimination::substitute(const Eigen::VectorXd& dense, Eigen::MatrixXd& nodes) const {
    nodes.resize(d_, static_cast<Index>(order_.size()));
    for (auto next = order_.rbegin(); next != order_.rend(); ++next) {
        const Index begin = filled_.begin(next->node);
        Eigen::VectorXd right = rows_.col(filled_.begin(next->node + 1) - 1);
        if (next->left >= 0) right += rows_.middleCols(begin, d_) * nodes.col(next->left);
        if (next->right >= 0) right += rows_.middleCols(begin + d_, d_) * nodes.col(next->right);
        for (const Range& range : filled_[next->node])
            right += rows_.middleCols(begin + 2 * d_ + range.at, range.count) *
                     dense.segment(range.first, range.count);
        factor_.middleCols(d_ * next->node, d_)
            .triangularView<Eigen::Lower>()
            .transpose()
            .solveInPlace(right);
        nodes.col(next->node) = -right;
    }
}

// Of what a node is eliminated onto the covariance is known before its own: from the last node that
// is eliminated down. A node's columns are among those of its neighbours.
void Elimination::covariances(const Eigen::MatrixXd& dense, const Take& take) const {
    const Index n = static_cast<Index>(order_.size());
    std::unordered_map<Index, Joint> above;
    Eigen::MatrixXd across = Eigen::MatrixXd::Zero(d_, dense.cols());
    const std::function<void(Index, Index)> descend = [&](Index node, Index reach) {
        const Joint& mine = above.emplace(node, joint(node, reach, above, dense)).first->second;
        for (const Range& range : filled_[node])
            across.middleCols(range.first, range.count) =
                mine.by_dense.middleCols(range.at, range.count);
        take(node, mine.own, across);
        if (reach > 1) descend(node - reach / 2, reach / 2);
        Index half = reach / 2;
        while (half > 0 && node + half >= n) half /= 2;
        if (half > 0) descend(node + half, half);
        above.erase(node);
    };
    Index reach = 1;
    while (2 * reach <= n) reach *= 2;
    if (n > 0) descend(reach - 1, reach);
}

Elimination::Joint Elimination::joint(Index node, Index reach,
                                      const std::unordered_map<Index, Joint>& above,
                                      const Eigen::MatrixXd& dense) const {
    const Ranges& ranges = filled_[node];
    const Index d = d_, n = static_cast<Index>(order_.size()), begin = filled_.begin(node),
                width = filled_.begin(node + 1) - begin - 2 * d - 1;
    Joint found;
    found.right = node + reach < n ? node + reach : -1;
    const Joint* left = node >= reach ? &above.at(node - reach) : nullptr;
    const Joint* right = found.right >= 0 ? &above.at(found.right) : nullptr;
    // The covariance of what it depends on: of its neighbours and its columns.
    Eigen::MatrixXd known = Eigen::MatrixXd::Zero(2 * d + width, 2 * d + width);
    if (left) known.topLeftCorner(d, d) = left->own;
    if (right) known.block(d, d, d, d) = right->own;
    if (left && right) {  // of two neighbours one was eliminated onto the other
        if (left->right == found.right)
            known.block(0, d, d, d) = left->by_right;
        else
            known.block(0, d, d, d) = right->by_left.transpose();
    }
    for (const Range& range : ranges) {
        const auto with = [&](Index row, const Joint* other, const Ranges& theirs) {
            if (other)
                known.block(row, 2 * d + range.at, d, range.count) =
                    other->by_dense.middleCols(place(theirs, range), range.count);
        };
        if (left) with(0, left, filled_[node - reach]);
        if (right) with(d, right, filled_[found.right]);
        for (const Range& other : ranges)
            known.block(2 * d + range.at, 2 * d + other.at, range.count, other.count) =
                dense.block(range.first, other.first, range.count, other.count);
    }
    known.triangularView<Eigen::StrictlyLower>() = known.transpose();
    const auto factor = factor_.middleCols(d * node, d).triangularView<Eigen::Lower>();
    Eigen::MatrixXd by = rows_.middleCols(begin, 2 * d + width);
    if (!left) by.leftCols(d).setZero();
    if (!right) by.middleCols(d, d).setZero();
    factor.transpose().solveInPlace(by);
    const Eigen::MatrixXd across = -by * known;
    found.own = factor.transpose().solve(factor.solve(Eigen::MatrixXd::Identity(d, d)).eval()) -
                across * by.transpose();
    found.by_left = across.leftCols(d);
    found.by_right = across.middleCols(d, d);
    found.by_dense = across.rightCols(width);
    return found;
}

}  // namespace trigpoint
