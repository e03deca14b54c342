"""The estimator over a session from Python."""

from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

from trigpoint.fusion.estimators.residuals import CameraResiduals
from trigpoint.fusion.estimators.results import Results
from trigpoint.tools.calibrate.work import fed, task_of

from .networks import Network, PathLike, Trajectory, network_of
from .sessions import Session


class Calibration(Struct, frozen=True, eq=False):
    """What a session says.

    `residuals`: of each camera's corners, predicted minus seen, pixels; empty where the estimator
    has none. `left_out`: how many messages were not used, by reason; `notes`: events (a camera that
    moved, a robot that was carried), what was wrong with messages, which noise is not as stated.
    """

    network: Network
    residuals: dict[str, CameraResiduals]
    left_out: dict[str, int]
    notes: tuple[str, ...]
    _results: Results

    def save(self, folder: PathLike) -> None:
        """Write network.json, covariance.npz and the trajectories; raises OperationError."""
        self._results.save(Path(folder))


def calibrate(
    session: PathLike | Session,
    *,
    site: PathLike | None = None,
    network: PathLike | None = None,
    topic: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
) -> Calibration:
    """Work out the network of a recorded session; deterministic, and faster than it took.

    `site`: the site file, by default the one in the session. `network`: a network.json whose
    cameras are known beforehand. `topic`: for anybody's bag, camera or robot -> its topic of
    pictures, sightings or odometry. `settings`: keys of the site file, dotted, to values in place
    of its own, like {"fusion.estimator": "ekf", "robots.r1.odometry.distance": 0.01}.

    Raises InputError where something given is wrong, OperationError where no odometry is sound.
    """
    task = task_of(
        session.path if isinstance(session, Session) else Path(session),
        site=None if site is None else Path(site),
        network=None if network is None else Path(network),
        topics=[f"{name}={place}" for name, place in (topic or {}).items()],
        settings=settings,
    )
    found = task.messages()
    pipeline = fed(found, task.inputs, source=task.path)
    pipeline.finish()
    results = pipeline.results()
    record, ways = results.network, results.trajectories
    return Calibration(
        network=network_of(
            record,
            covariance=lambda: results.covariance,
            trajectory=lambda robot: Trajectory(*ways[robot]),
        ),
        residuals=pipeline.residuals(),
        left_out=pipeline.messages_left_out,
        notes=(*found.unsound(), *pipeline.notes, *results.doubts, *results.noise),
        _results=results,
    )
