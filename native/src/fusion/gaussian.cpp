// A Gaussian of many unknowns of which few are kept up to date; see `fusion/solver/gaussian.py`.
#include <Eigen/Cholesky>
#include <stdexcept>
#include <vector>

#include "border.hpp"
#include "geometry/pose.hpp"

using namespace trigpoint;

namespace {

using Eigen::Index;

// The near columns: of the module's formulas P_nn, Φ, Ψ (k rows each), m_n and θ (one each).
template <class Numbers>
class Near {
public:
    explicit Near(const Array& table)
        : size(table.shape[1]), table_(table.as<double>(), table.shape[0], size) {
        if (table.shape[0] != 3 * size + 2)
            throw std::invalid_argument("a table of near columns has three squares and two rows");
    }
    const Index size;
    auto covariance() { return table_.topRows(size); }
    auto carry() { return table_.middleRows(size, size); }
    auto weight() { return table_.middleRows(2 * size, size); }
    auto mean() { return table_.row(3 * size); }
    auto pull() { return table_.row(3 * size + 1); }
    void set(Near<const RowMajor>& other) { table_ = other.table_; }

private:
    friend class Near<RowMajor>;
    Eigen::Map<Numbers> table_;
};
using Known = Near<const RowMajor>;
using Made = Near<RowMajor>;

// Indices that lie below a limit.
std::vector<Index> indices(const Array& array, Index limit) {
    const std::int64_t* first = array.as<std::int64_t>();
    const std::vector<Index> found(first, first + array.shape[0]);
    for (const Index one : found)
        if (one < 0 || one >= limit) throw std::out_of_range("no such column");
    return found;
}

}  // namespace

// (the earlier mean (n,) and covariance (n, n), the near columns (k,) and their table (3 k + 2, k),
// columns (m,) to make near, the table (3 l + 2, l) with them, l = k + m): 0.
TRIGPOINT_KERNEL(tp_near_extended) {
    const Index whole = arguments[0].array.shape[0];
    const Eigen::Map<const Eigen::VectorXd> mean(arguments[0].array.as<double>(), whole);
    const Eigen::Map<const RowMajor> covariance(arguments[1].array.as<double>(), whole, whole);
    const std::vector<Index> columns = indices(arguments[2].array, whole),
                             added = indices(arguments[4].array, whole);
    Known near(arguments[3].array);
    Made made(arguments[5].array);
    const Index k = near.size, m = static_cast<Index>(added.size());
    if (static_cast<Index>(columns.size()) != k || made.size != k + m)
        throw std::invalid_argument("other columns than the table has");
    const Eigen::MatrixXd across = covariance(columns, added);
    const Eigen::MatrixXd weighted = near.weight() * across;
    made.covariance().topLeftCorner(k, k) = near.covariance();
    made.covariance().topRightCorner(k, m) = near.carry() * across;
    made.covariance().bottomLeftCorner(m, k) = made.covariance().topRightCorner(k, m).transpose();
    made.covariance().bottomRightCorner(m, m) =
        covariance(added, added) - across.transpose() * weighted;
    made.carry().topLeftCorner(k, k) = near.carry();
    made.carry().topRightCorner(k, m).setZero();
    made.carry().bottomLeftCorner(m, k) = -weighted.transpose();
    made.carry().bottomRightCorner(m, m).setIdentity();
    made.weight().setZero();
    made.weight().topLeftCorner(k, k) = near.weight();
    made.mean() << near.mean(), mean(added).transpose() + near.pull() * across;
    made.pull().setZero();
    made.pull().head(k) = near.pull();
    return 0;
}

// (a table, rows (m,) that are replaced, rows (q,) of which they come, matrix (m, q), shift (m,),
// noise (m, m), the table after): 0.
TRIGPOINT_KERNEL(tp_near_moved) {
    Known near(arguments[0].array);
    Made made(arguments[6].array);
    const std::vector<Index> rows = indices(arguments[1].array, near.size),
                             source = indices(arguments[2].array, near.size);
    const auto m = static_cast<Index>(rows.size()), q = static_cast<Index>(source.size());
    const Eigen::Map<const RowMajor> matrix(arguments[3].array.as<double>(), m, q),
        noise(arguments[5].array.as<double>(), m, m);
    const Eigen::Map<const Eigen::VectorXd> shift(arguments[4].array.as<double>(), m);
    made.set(near);
    const Eigen::MatrixXd across = matrix * near.covariance()(source, Eigen::all);
    const Eigen::MatrixXd carried = matrix * near.carry()(source, Eigen::all);
    const Eigen::MatrixXd own = across(Eigen::all, source) * matrix.transpose() + noise;
    const Eigen::VectorXd mean = matrix * near.mean()(source).transpose().eval() + shift;
    for (Index i = 0; i < m; ++i) {
        const Index row = rows[static_cast<std::size_t>(i)];
        made.covariance().row(row) = across.row(i);
        made.covariance().col(row) = across.row(i).transpose();
        made.carry().row(row) = carried.row(i);
        made.mean()[row] = mean[i];
    }
    for (Index i = 0; i < m; ++i)
        for (Index j = 0; j < m; ++j)
            made.covariance()(rows[static_cast<std::size_t>(i)],
                              rows[static_cast<std::size_t>(j)]) = own(i, j);
    return 0;
}

// (a table, rows (m,), Jacobian (r, m) by them, residual (r,) where they are 0, rows (f,) that may
// be changed, or whether all may, the table after, the whitened innovation (r,)): 1, or 0 where the
// innovation's covariance is not positive definite. With S = 1 + H P Hᵀ = L Lᵀ the gain of the near
// columns is P Hᵀ L⁻ᵀ, that of the far ones P⁰_fn Φᵀ Hᵀ L⁻ᵀ.
TRIGPOINT_KERNEL(tp_near_updated) {
    Known near(arguments[0].array);
    Made made(arguments[6].array);
    const std::vector<Index> rows = indices(arguments[1].array, near.size),
                             free = indices(arguments[4].array, near.size);
    const Index r = arguments[3].array.shape[0], m = static_cast<Index>(rows.size());
    const Eigen::Map<const RowMajor> jacobian(arguments[2].array.as<double>(), r, m);
    const Eigen::Map<const Eigen::VectorXd> residual(arguments[3].array.as<double>(), r);
    Eigen::Map<Eigen::VectorXd> whitened(arguments[7].array.as<double>(), r);
    Eigen::MatrixXd gain = near.covariance()(Eigen::all, rows) * jacobian.transpose();
    Eigen::MatrixXd far = near.carry()(rows, Eigen::all).transpose() * jacobian.transpose();
    Eigen::MatrixXd innovation = jacobian * gain(rows, Eigen::all);
    innovation.diagonal().array() += 1;
    const Eigen::LLT<Eigen::MatrixXd> root(innovation);
    if (root.info() != Eigen::Success || !innovation.allFinite()) return 0;
    whitened = root.matrixL().solve(residual + jacobian * near.mean()(rows).transpose().eval());
    root.matrixU().solveInPlace<Eigen::OnTheRight>(gain);
    root.matrixU().solveInPlace<Eigen::OnTheRight>(far);
    made.set(near);
    if (arguments[5].whole == 0) {
        Eigen::MatrixXd own = Eigen::MatrixXd::Zero(gain.rows(), r);
        for (const Index row : free) own.row(row) = gain.row(row);
        const Eigen::MatrixXd across = own * gain.transpose();
        made.mean() -= (own * whitened).transpose();
        made.covariance() += own * own.transpose() - across - across.transpose();
        made.carry() -= own * far.transpose();
        return 1;
    }
    made.mean() -= (gain * whitened).transpose();
    made.covariance() -= gain * gain.transpose();
    made.carry() -= gain * far.transpose();
    made.weight() += far * far.transpose();
    made.pull() -= (far * whitened).transpose();
    return 1;
}
