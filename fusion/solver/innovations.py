"""How far each sighting of a solution is from where everything else predicts it."""

import numpy as np
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.problem import State
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .equations import Equations, EquationsHandle
from .tables import PROBLEM, STATE, problem_tables, state_tables

_INNOVATIONS = Kernel(
    *("tp_innovations", EquationsHandle, *STATE, *PROBLEM),
    *(In(np.int64, ("s", 3)), In(np.float64, (6,)), Out(np.float64, ("s", 2))),
)


def innovations(
    equations: Equations,
    state: State,
    sightings: np.ndarray,
    *,
    room_variances: Array,
) -> tuple[Array, Array]:
    """νᵀS⁻¹ν and ln |S| (s,) of the innovations ν of the poses (m, rad) of sightings (s, 3), each
    given everything else: the picture, among those of all batches, its first corner and how many;
    ln |S| is -inf where one determines no pose. `equations`: at this `state`, from where the
    minimum is a step; `room_variances` (6,): of a pose anywhere in the room. Raises LinAlgError
    where an unknown is not determined.

    A solution of covariance Σ has each sighting in it. Where H is the derivative of its pose, of
    covariance P by itself, the residual has the covariance R = P - HΣHᵀ, and ν is P R⁻¹ times it.
    """
    problem, found = equations.problem, np.empty((len(sightings), 2))
    tables = *state_tables(problem, state), *problem_tables(problem, state)
    if not _INNOVATIONS(equations.handle, *tables, sightings, room_variances, found):
        raise LinAlgError("an unknown is not determined")
    return found[:, 0], found[:, 1]
