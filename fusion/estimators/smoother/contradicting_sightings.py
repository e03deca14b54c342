"""Sightings that contradict the solution which they are a part of.

The association judges most of a session's sightings to first order, and those that it did not
choose to look at each by itself. In the solution everything has its word, also how the robot stood
otherwise in each picture than its odometry says. What a sighting would have it stand otherwise
than that, ν, has there at most its own covariance P; so with the score of a sighting that is right
at least νᵀP⁻¹ν + ln |P|, one for which that is more than a wrong one's is wrong, whatever the rest
of its covariance is.
"""

import numpy as np

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.prediction import base_jacobian, batch_residual
from trigpoint.fusion.model.problem import Batch, State
from trigpoint.fusion.reading.best_readings import groups_of
from trigpoint.fusion.solver.picture_jitter import PictureJitter

_Excess = tuple[float, int, int]


def leave_out_contradicting(
    data: DataSet, assembled: Assembled, state: State, events: Events
) -> bool:
    """Leave out the worst of each robot's sightings that contradict the solution; whether any was.

    What draws good ones off beside it is at least twice as bad as they are; they get another look.
    """
    worst: dict[str, float] = {}
    found: list[tuple[str, _Excess]] = []
    for batch in assembled.problem.batches:
        for excess in _excesses(data, assembled, batch, state, events):
            worst[batch.robot] = max(worst.get(batch.robot, 0.0), excess[0])
            found.append((batch.robot, excess))
    left_out = [each for robot, each in found if each[0] > worst[robot] / 2]
    for _, source, order in left_out:
        entry = data.entries[source]
        wild = list(entry.observation.wild)
        wild[order] = np.ones_like(wild[order])
        entry.observation = entry.observation.with_outliers(tuple(wild))
    return bool(left_out)


def _excesses(
    data: DataSet, assembled: Assembled, batch: Batch, state: State, events: Events
) -> list[_Excess]:
    """By how much each sighting of a batch that contradicts is worse than a wrong one, with its
    source and order."""
    by_base = base_jacobian(assembled.problem, batch, state)
    residual = batch_residual(assembled.problem, batch, state)
    jitter, found = PictureJitter.of(assembled.problem, batch, state), []
    if jitter is not None:
        residual = jitter.compensated(residual.reshape(len(residual), -1)).reshape(residual.shape)
    shown = [
        (row, source, order, part)
        for row, source in enumerate(batch.sources.tolist())
        for order, part in enumerate(data.entries[source].observation.parts)
        if np.any(by_base[row, part])  # it is not left out already
    ]
    for rows in groups_of([part.stop - part.start for *_, part in shown]):
        mine = [shown[each] for each in rows.tolist()]
        flat = np.stack([by_base[row, part] for row, _, _, part in mine])
        flat = flat.reshape(len(mine), -1, 6)
        left = np.stack([residual[row, part].reshape(-1, 1) for row, _, _, part in mine])
        turned = np.swapaxes(flat, 1, 2)
        information = turned @ flat + np.diag(1 / events.room_variances)
        pull = turned @ left
        chi2 = np.sum(pull * np.linalg.solve(information, pull), axis=(1, 2))
        excess = events.over_anywhere(chi2, -np.linalg.slogdet(information)[1])
        found += [
            (float(excess[each]), mine[each][1], mine[each][2])
            for each in np.flatnonzero(excess > 0).tolist()
        ]
    return found
