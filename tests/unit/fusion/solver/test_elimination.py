"""Both ways to eliminate a chain, against each other."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from trigpoint.fusion.solver.elimination import BandElimination, NestedElimination
from trigpoint.fusion.solver.normal_equations import ChainEquations, Coupling

D = 3


def chain_equations(
    nodes: int, cameras: int, *, seed: int = 0
) -> tuple[ChainEquations, np.ndarray]:
    """A chain of which each node sees one camera, or none, and the dense part's own information:
    the sum of squares of terms over a node and its neighbour or a camera."""
    rng = np.random.default_rng(seed)
    size = 6 * cameras + D
    equations = ChainEquations.zeros(nodes, D, size)
    dense = np.zeros((size, size))
    equations.gradient[:] = rng.normal(size=(nodes, D))
    for node in range(nodes):
        step = rng.normal(size=(2 * D, 2 * D))
        square = step.T @ step
        equations.diagonal[node] += square[:D, :D] + 0.1 * np.eye(D)
        if node + 1 < nodes:
            equations.diagonal[node + 1] += square[D:, D:]
            equations.lower[node] = square[D:, :D]
    for camera in range(cameras):
        rows = np.sort(rng.choice(nodes, size=max(1, nodes // (2 * cameras)), replace=False))
        columns = np.arange(6 * camera, 6 * camera + 6)
        sight = rng.normal(size=(len(rows), 12, D + 6))
        square = np.swapaxes(sight, 1, 2) @ sight
        equations.diagonal[rows] += square[:, :D, :D]
        equations.couplings.append(Coupling(rows, square[:, :D, D:], columns))
        dense[np.ix_(columns, columns)] += square[:, D:, D:].sum(axis=0)
    last = np.arange(6 * cameras, size)
    equations.couplings.append(Coupling(np.array([nodes - 1]), rng.normal(size=(1, D, D)), last))
    dense[last, last] += 10.0
    return equations, dense


@pytest.mark.parametrize(("nodes", "cameras"), [(1, 1), (2, 1), (37, 5), (400, 30)])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_nested_elimination_is_the_band_elimination(
    nodes: int, cameras: int, damping: float
) -> None:
    equations, dense = chain_equations(nodes, cameras)
    band = BandElimination(equations, damping)
    nested = NestedElimination(equations, dense, damping)
    scale = np.abs(band.information).max()
    np.testing.assert_allclose(nested.information, band.information, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(
        nested.gradient, band.gradient, rtol=0, atol=1e-9 * np.abs(band.gradient).max()
    )
    step = np.random.default_rng(1).normal(size=len(dense))
    expected = band.nodes(step)
    np.testing.assert_allclose(
        nested.nodes(step), expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )


def test_nodes_seen_twice_add_up() -> None:
    equations, dense = chain_equations(8, 2)
    rows, columns = np.array([3, 3, 5]), np.arange(6)
    blocks = np.random.default_rng(2).normal(size=(3, D, 6))
    equations.couplings.append(Coupling(rows, blocks, columns))
    whole = np.zeros((8, D, equations.dense_size))
    for part in equations.couplings:
        for row, block in zip(part.rows, part.blocks, strict=True):
            whole[row][:, part.columns] += block
    np.testing.assert_allclose(equations.coupling, whole)
    np.testing.assert_allclose(
        NestedElimination(equations, dense, 0.0).information,
        BandElimination(equations, 0.0).information,
        atol=1e-9 * np.abs(dense).max(),
    )


def test_nested_elimination_keeps_couplings_sparse() -> None:
    """Each level doubles the cameras that a node carries and halves the nodes."""
    equations, dense = chain_equations(2000, 40)
    nested = NestedElimination(equations, dense, 0.0)
    inner = 2000 * D
    filled = nested._factors.L[inner:, :inner].nnz
    assert filled < 0.25 * inner * len(dense)


def test_what_is_not_positive_definite_is_refused() -> None:
    equations, dense = chain_equations(20, 3)
    equations.diagonal[4] -= 100 * np.eye(D)
    for eliminate in (
        lambda: BandElimination(equations, 0.0),
        lambda: NestedElimination(equations, dense, 0.0),
    ):
        with pytest.raises(LinAlgError):
            eliminate()
