"""Equations made of blocks: dense and sparse say the same, and what is not determined is told."""

import numpy as np
import pytest

from trigpoint.fusion.association import equations
from trigpoint.fusion.association.equations import Pattern
from trigpoint.geometry.rotation import Array

CHAIN, SIZE = 40, 122
"""Nodes of three unknowns in a chain, and two unknowns that every step shares."""


def blocks(count: int, *, held: float = 1.0) -> tuple[list[np.ndarray], list[Array], list[Array]]:
    """Of `count` graphs: where blocks stand, their matrices and their gradients; `held`: how well
    the first node is known."""
    random = np.random.default_rng(7)
    nodes = np.arange(3 * CHAIN).reshape(CHAIN, 3)
    shared = np.tile([SIZE - 2, SIZE - 1], (CHAIN - 1, 1))
    rows = [nodes[:1], np.concatenate([nodes[:-1], nodes[1:], shared], axis=1)]
    by_step = random.normal(size=(count, CHAIN - 1, 4, 8))
    first = np.tile(held * np.eye(3), (count, 1, 1, 1))
    hessians: list[Array] = [first, np.swapaxes(by_step, -1, -2) @ by_step]
    shapes = (count, 1, 3), (count, CHAIN - 1, 8)
    gradients: list[Array] = [random.normal(size=shape) for shape in shapes]
    return rows, hessians, gradients


def summed(rows: list[np.ndarray], parts: list[Array]) -> Array:
    """The matrix (n, n) of the first graph, block by block."""
    matrix = np.zeros((SIZE, SIZE))
    for places, hessians in zip(rows, parts, strict=True):
        for at, hessian in zip(places, hessians[0], strict=True):
            matrix[np.ix_(at, at)] += hessian
    return matrix


@pytest.mark.parametrize("sparse_from", [0, 10**6])
def test_step_and_covariance_are_those_of_the_whole_matrix(
    monkeypatch: pytest.MonkeyPatch, sparse_from: int
) -> None:
    monkeypatch.setattr(equations, "SPARSE_FROM", sparse_from)
    rows, hessians, gradients = blocks(2)
    found = Pattern(SIZE, rows).equations(hessians, gradients, count=2)
    matrix = summed(rows, hessians)
    np.testing.assert_allclose(found.step()[0], -np.linalg.solve(matrix, found.gradient[0]))
    factor = found.factors()[0]
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(matrix)[1])
    asked = np.array([5, 4, SIZE - 1])
    whole = np.linalg.inv(matrix)
    np.testing.assert_allclose(factor.covariance(asked), whole[np.ix_(asked, asked)], rtol=1e-6)


@pytest.mark.parametrize("held", [0.0, -1.0])
def test_what_is_not_determined_is_told(held: float) -> None:
    rows, hessians, gradients = blocks(1, held=held)
    hessians[1][:, 0, :3] = hessians[1][:, 0, :, :3] = 0.0  # nothing else ties the first node
    with pytest.raises(np.linalg.LinAlgError):
        Pattern(SIZE, rows).equations(hessians, gradients, count=1)


@pytest.mark.parametrize("sparse_from", [0, 10**6])
@pytest.mark.parametrize("about", [0.0, -0.5])
def test_what_only_together_is_not_determined_is_told(
    monkeypatch: pytest.MonkeyPatch, sparse_from: int, about: float
) -> None:
    monkeypatch.setattr(equations, "SPARSE_FROM", sparse_from)
    rows, hessians, gradients = blocks(1)
    rows.append(np.array([[SIZE - 2, SIZE - 1]]))
    hessians[1][..., 6:], hessians[1][..., 6:, :] = 0.0, 0.0
    hessians.append(np.array([[[[1.0, 1.0 - about], [1.0 - about, 1.0]]]]))
    gradients.append(np.zeros((1, 1, 2)))
    found = Pattern(SIZE, rows).equations(hessians, gradients, count=1)
    with pytest.raises(np.linalg.LinAlgError):
        found.factors()


def test_no_unknowns_are_no_equations() -> None:
    found = Pattern(0, []).equations([], [], count=3)
    assert found.step().shape == (3, 0)
    assert [factor.log_determinant for factor in found.factors()] == [0.0, 0.0, 0.0]
