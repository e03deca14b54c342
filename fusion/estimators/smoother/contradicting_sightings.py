"""Sightings that contradict the solution of which they are a part.

The association judges most of a session's sightings to first order, and those outside the subset
that it examines each by itself. In the solution all of them take part, and so does the robot's
deviation in each picture from its odometry. The further offset ν of the pose that a sighting calls
for has at most its own covariance P there; so a correct sighting scores at least νᵀP⁻¹ν + ln |P|,
and one for which that exceeds the score of a wrong one is wrong, whatever the rest of its
covariance.
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

    A wrong sighting that pulls good ones away is at least twice as bad as they are, so those that
    are less than half as bad as the worst are judged again later.
    """
    worst: dict[str, float] = {}
    found: list[tuple[str, _Excess]] = []
    for batch in assembled.problem.batches:
        for excess in _excesses(data, batch, state, events):
            worst[batch.robot] = max(worst.get(batch.robot, 0.0), excess[0])
            found.append((batch.robot, excess))
    left_out = [each for robot, each in found if each[0] > worst[robot] / 2]
    for _, source, order in left_out:
        entry = data.entries[source]
        wild = list(entry.observation.wild)
        wild[order] = np.ones_like(wild[order])
        entry.observation = entry.observation.with_outliers(tuple(wild))
    return bool(left_out)


def _excesses(data: DataSet, batch: Batch, state: State, events: Events) -> list[_Excess]:
    """By how much the score of each contradicting sighting of a batch exceeds a wrong one's, with
    its source and order."""
    by_base = base_jacobian(batch, state)
    residual = batch_residual(batch, state)
    jitter, found = PictureJitter.of(batch, state), []
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
