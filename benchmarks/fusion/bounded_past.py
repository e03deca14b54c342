"""A long session whose past is summarised, beside the same solved as a whole.

    python -m benchmarks bounded [--laps L] [--sessions S]
    python -m benchmarks bounded --days D [--laps L] [--cameras C]

A robot drives L times round ten cameras: with each lap it comes before each once. Both times all of
it is explained; once with the limits of a live map (`settled_past.LIVE`), once with none. Errors
are those of the cameras' poses by the truth, their squares by their covariances: 1 is to be
expected, by each of the six unknowns of a camera.

With `--days` it does so each day, switched on at the same place with its odometry anew. After each,
the map is held against one solution of every sighting so far, as the map read it.
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer
from support.fusion.solvers import SlowSolver

from benchmarks.table import Row
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.estimators.smoother.settled_past import LIVE, Limits
from trigpoint.fusion.inbox import Input
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.problem import CameraState, State
from trigpoint.fusion.model.readings import Readings
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.fusion.solver.levenberg_marquardt import solve_consistently
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.tools.simulation.session import EPOCH_NS

from .corridor import DAY_NS, Corridor

_CAMERAS = 10
_NEVER = Limits(10**9, 10**9, 10**9)


def main(
    laps: Annotated[
        float | None, typer.Option(help="30, and 2 a day; the past begins after 24 by ten cameras.")
    ] = None,
    sessions: Annotated[int, typer.Option(help="How many, each drawn anew.")] = 4,
    days: Annotated[int, typer.Option(help="Of one map, day by day.")] = 1,
    cameras: Annotated[int, typer.Option(help="Round the ring.")] = _CAMERAS,
) -> list[Row]:
    """Hold a map with a summarised past against the solution over everything."""
    laps = laps or (30 if days == 1 else 2)
    driven_s = laps * Corridor(cameras, 0.0).lap_s
    corridor = Corridor(cameras, driven_s, pictures_hz=1.0)
    if days > 1:
        return list(_rows(f"{days} days of {laps:g} laps", *_days(corridor, days)))
    found = [np.concatenate(list(_errors(corridor, limits, sessions))) for limits in (LIVE, _NEVER)]
    return list(_rows(f"{sessions} × {laps:g} laps", *found))


def _rows(what: str, bounded: Array, whole: Array) -> Iterator[Row]:
    for name, unit, column, power in (
        ("error of a position", "mm", 0, 0.5),
        ("error of an orientation", "mrad", 1, 0.5),
        ("squared errors by covariance", "1", 2, 1.0),
    ):
        scale = 1e3 if power < 1 else 1.0
        ours, other = (scale * np.mean(each[:, column]) ** power for each in (bounded, whole))
        yield Row("bounded", f"{what}, {name}", unit, float(ours), float(other), "all at once")


def _errors(corridor: Corridor, limits: Limits, sessions: int) -> Iterator[Array]:
    """The errors of each session (`_apart`)."""
    for seed in range(sessions):
        solver = SlowSolver(corridor.inputs, limits=limits)
        pipeline = Pipeline(corridor.inputs, is_live=False, solver=solver)
        replayed(pipeline, corridor.messages(seed=seed))
        pipeline.finish()
        rows = _apart(corridor, *_found(pipeline.results().network))
        has_past = pipeline.past is not None
        assert has_past == (limits is LIVE), "there is no past yet; drive on for longer"
        typer.echo(f"session {seed}, past {has_past}: {np.mean(rows, axis=0)}", err=True)
        yield rows


def _found(network: Network) -> tuple[list[Pose], list[Array]]:
    """Where a network has the cameras, and the covariances of that."""
    poses, covariances = [], []
    for name, camera in network.cameras.items():
        assert camera.map_from_camera is not None, (name, camera.undetermined)
        poses.append(camera.map_from_camera.pose)
        covariances.append(camera.covariance_matrix)
    return poses, covariances


def _apart(corridor: Corridor, poses: list[Pose], covariances: list[Array]) -> Array:
    """By camera, the squared errors of its position, m², and orientation, rad², and of both by
    their covariance and number; and the variance of its position, m²."""
    rows = []
    for index, (pose, covariance) in enumerate(zip(poses, covariances, strict=True)):
        error = pose.difference(corridor.camera(index))
        by_covariance = error @ np.linalg.solve(covariance, error) / 6
        squares = np.sum(error[:3] ** 2), np.sum(error[3:] ** 2)
        rows.append((*squares, by_covariance, np.trace(covariance[:3, :3])))
    return np.array(rows)


def _days(corridor: Corridor, days: int) -> tuple[Array, Array]:
    """The errors (`_apart`) of a map after its last day, and of all at once."""
    solver, whole = SlowSolver(corridor.inputs), corridor.inputs.data_set()
    pipeline = Pipeline(corridor.inputs, is_live=False, solver=solver)
    found = []
    for day in range(days):
        later_ns = day * DAY_NS
        messages = list(corridor.messages(seed=day, later_ns=later_ns))
        replayed(pipeline, messages)
        pipeline.finish()
        while not pipeline.reports.is_answered:
            pipeline.advance()
        _take(whole, messages, solver.data, EPOCH_NS + later_ns)
        map_of_day = _found(pipeline.results().network)
        found = [_apart(corridor, *each) for each in (map_of_day, _at_once(whole, map_of_day[0]))]
        told = (1e3 * np.sqrt(np.mean(each[:, [0, 3]], axis=0)) for each in found)
        words = ("{:.1f} mm, by covariance {:.1f}".format(*each) for each in told)
        typer.echo(f"day {day + 1}: {next(words)}; all at once {next(words)}", err=True)
    return found[0], found[1]


def _take(whole: DataSet, messages: list[tuple[str, Input]], live: DataSet, since_ns: int) -> None:
    """Add a day's odometry, and its sightings as the map read them."""
    readings = [message for _, message in messages if isinstance(message, Odometry)]
    whole.tracks["r1"].add_run(Readings.of(readings))
    whole.lenses.update(live.lenses)
    new = (each for each in live.entries if each.observation.stamp_ns >= since_ns)
    whole.entries += [Entry(each.observation, each.map_from_base, each.share) for each in new]


def _at_once(whole: DataSet, near: list[Pose]) -> tuple[list[Pose], list[Array]]:
    """Where one solution near these poses has the cameras, and the covariances of that."""
    cameras = {
        name: CameraState(pose, whole.lenses[name])
        for name, pose in zip(whole.site.cameras, near, strict=True)
    }
    state = State(cameras, whole.first_state().robots)
    solved = solve_consistently(whole, state, tolerance=1e-4)
    assert solved is not None
    reduced = solved.solution.reduced
    joint, columns = reduced.covariance(), [reduced.layout.pose[name] for name in cameras]
    poses = [solved.state.cameras[name].map_from_camera for name in cameras]
    return poses, [joint[np.ix_(own, own)] for own in columns]
