// Normal equations of which chains of nodes are a part, and the elimination of these.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <unordered_map>
#include <vector>

namespace trigpoint {

using Index = Eigen::Index;

// Columns of the dense part, and where they begin in something narrower.
struct Range {
    Index first, count, at;

    bool operator<(const Range& other) const {
        return first < other.first || (first == other.first && count < other.count);
    }
};
using Ranges = std::vector<Range>;

// Columns that each node of a chain is coupled with, in ascending order.
class Coupled {
public:
    std::vector<Ranges> of;     // by node
    std::vector<Index> begins;  // of a node's columns among those of all, and where the last ends

    explicit Coupled(Index nodes) : of(static_cast<std::size_t>(nodes)) {}
    const Ranges& operator[](Index node) const { return of[static_cast<std::size_t>(node)]; }
    Index begin(Index node) const { return begins[static_cast<std::size_t>(node)]; }
    void add(Index node, const Range& range);
    // Lays all out side by side, with `more` columns for each node.
    void lay_out(Index more);
};
// Where columns are among those of a node; they must be.
Index place(const Ranges& ranges, const Range& range);

// The normal equations of the inner nodes of a chain, n of them: a node is coupled with the next,
// and with the few columns of the dense part by which what sees it is described.
struct ChainEquations {
    Index d;
    Coupled coupled;
    Eigen::MatrixXd diagonal, lower;  // (d, n d); [i]: of node i; of node i + 1 by node i
    Eigen::MatrixXd gradient;         // (d, n)
    Eigen::MatrixXd coupling;         // (d, columns)

    ChainEquations(Index unknowns, Coupled with);
    Index nodes() const { return gradient.cols(); }
};

// Half the Hessian and the gradient of a cost at a state.
struct Equations {
    std::vector<ChainEquations> chains;
    Eigen::MatrixXd dense;
    Eigen::VectorXd gradient;
    double cost = 0;
    double log_determinant = 0;  // of the pictures' covariance with their jitter

    void clear();
    // Adds a term over `inner` nodes of a chain, 0 to 2, from `node` on, whose columns come first,
    // and the columns of the dense part that `parts` say.
    void add(ChainEquations& chain, Index node, Index inner, const Ranges& parts,
             const Eigen::Ref<const Eigen::MatrixXd>& square,
             const Eigen::Ref<const Eigen::VectorXd>& pull);
    // One over columns of the dense part alone.
    void add_dense(const Ranges& parts, const Eigen::Ref<const Eigen::MatrixXd>& square,
                   const Eigen::Ref<const Eigen::VectorXd>& pull);
};

// Whether a matrix is positive definite; its Cholesky factor then is its lower triangle.
bool factorised(Eigen::Ref<Eigen::MatrixXd> matrix);

// Eliminates a chain. Every other node is eliminated onto its two neighbours and the columns that
// it is coupled with, then every other one of those left, and so on (nested dissection): the nodes
// left are coupled with more columns, but are soon few.
class Elimination {
public:
    explicit Elimination(const ChainEquations& chain);

    // Takes the Schur complement from the information and the gradient of the dense part. With A
    // over the nodes, its diagonal damped, B the coupling and g the gradient: BᵀA⁻¹B, BᵀA⁻¹g; false
    // where A is not positive definite.
    bool eliminate(const ChainEquations& chain, double damping, Eigen::MatrixXd& information,
                   Eigen::VectorXd& gradient);
    // The nodes' step -A⁻¹(g + B y), (d, n), for a step y of the dense part.
    void substitute(const Eigen::VectorXd& dense, Eigen::MatrixXd& nodes) const;
    // Hands over each node with its covariance (d, d) and that (d, q) with those columns of the
    // dense part, whose covariance (q, q) is `dense`, that it is coupled with. Kept at once are
    // those of a few nodes.
    using Take = std::function<void(Index, const Eigen::MatrixXd&, const Eigen::MatrixXd&)>;
    void covariances(const Eigen::MatrixXd& dense, const Take& take) const;

private:
    struct Order {
        Index node, left, right;  // and its neighbours when it is eliminated, -1: none
    };
    Index d_;
    std::vector<Order> order_;
    Coupled filled_;
    // Of each node: the factor of its own information; and times that one's inverse, its coupling
    // with its left (d) and right (d) neighbour and the dense part, and its gradient (1).
    Eigen::MatrixXd factor_, rows_;

    // A node's covariance, and those with its neighbours and with the columns that it is coupled
    // with; its right neighbour.
    struct Joint {
        Eigen::MatrixXd own, by_left, by_right, by_dense;
        Index right;
    };

    auto rows(Index node) {
        return rows_.middleCols(filled_.begin(node), filled_.begin(node + 1) - filled_.begin(node));
    }
    // Of a node that is eliminated onto those `reach` before and after it.
    Joint joint(Index node, Index reach, const std::unordered_map<Index, Joint>& above,
                const Eigen::MatrixXd& dense) const;
    void onto(Index neighbour, const Ranges& ranges,
              const Eigen::Ref<const Eigen::MatrixXd>& across,
              const Eigen::Ref<const Eigen::MatrixXd>& own);
};

}  // namespace trigpoint
