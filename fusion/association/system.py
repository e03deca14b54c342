"""The full normal equations of a small problem, with nothing eliminated."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from trigpoint.fusion.model.problem import Problem, State
from trigpoint.fusion.solver.normal_equations import EXACT, NormalEquations, linearise
from trigpoint.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class System:
    """The full system at a state. `covariance`: of all unknowns, the chains' inner nodes first, and
    then the dense part; `step`: from there to the minimum; `log_determinant`: of the covariance's
    inverse, without what holds an anchored chain's first node, plus that of the pictures' jitter;
    `first_row`: by robot, the first row of its nodes; `dense_row`: the first of the dense part."""

    problem: Problem
    cost: float
    covariance: Array
    step: Array
    log_determinant: float
    first_row: dict[str, int]
    dense_row: int

    @classmethod
    def of(
        cls, problem: Problem, state: State, equations: NormalEquations | None = None
    ) -> "System":
        """The system at a state; raise LinAlgError where an unknown is not determined.
        `equations`: the normal equations there, where they are known already."""
        equations = equations or linearise(problem, state)
        sizes = {name: equations.chains[name].gradient.size for name in problem.chains}
        dense_row = sum(sizes.values())
        total = dense_row + problem.layout.size
        matrix = np.zeros((total, total))
        matrix[dense_row:, dense_row:] = equations.dense
        gradients = [equations.chains[name].gradient.reshape(-1) for name in sizes]
        gradient = np.concatenate([*gradients, equations.gradient])
        rows, start, held = {}, 0, 0
        for name, size in sizes.items():
            chain, d = equations.chains[name], len(problem.chains[name].tangent)
            held += d if problem.chains[name].is_anchored else 0
            rows[name] = start
            inner = slice(start, start + size)
            coupling = chain.coupling.reshape(size, problem.layout.size)
            matrix[inner, dense_row:] = coupling
            matrix[dense_row:, inner] = coupling.T
            for node in range(size // d):
                at = slice(start + node * d, start + (node + 1) * d)
                matrix[at, at] = chain.diagonal[node]
                if node + 1 < size // d:
                    after = slice(at.stop, at.stop + d)
                    matrix[after, at] = chain.lower[node]
                    matrix[at, after] = chain.lower[node].T
            start += size
        scale = 1 / np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        factor = cho_factor(matrix * scale[:, None] * scale, lower=True)
        inverse = cho_solve(factor, np.eye(total)) * scale[:, None] * scale
        log_determinant = 2 * float(np.sum(np.log(np.diagonal(factor[0])) - np.log(scale)))
        log_determinant += equations.log_determinant - held * float(np.log(EXACT))
        step = -inverse @ gradient
        return cls(problem, equations.cost, inverse, step, log_determinant, rows, dense_row)

    def node_rows(self, robot: str, node: int) -> np.ndarray:
        """The rows (d,) of a robot's node."""
        chain = self.problem.chains[robot]
        d = len(chain.tangent)
        if node == len(chain) - 1:
            return self.dense_row + self.problem.layout.last[robot]
        return self.first_row[robot] + node * d + np.arange(d)
