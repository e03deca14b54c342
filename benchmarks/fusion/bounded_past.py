"""A long session whose past is summarised, beside the same solved as a whole.

    PYTHONPATH=tests python -m benchmarks bounded [--laps L] [--sessions S] [--lenses]

A robot drives L times round ten cameras: with each lap it comes before each once. Both times all of
it is explained; once with the limits of a live map (`settled_past.LIVE`), once with none. Errors
are those of the cameras' poses by the truth, their squares by their covariances: 1 is to be
expected, by each of the six unknowns of a camera.
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer
from support.fusion.solvers import SlowSolver

from benchmarks.table import Row
from trigpoint.fusion.estimators.smoother.settled_past import LIVE, Limits
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.geometry.rotation import Array

from .corridor import Corridor

_CAMERAS = 10
_LENSES = 'intrinsics = "estimate"\ntime_offset_sigma = 0.01\n'
_NEVER = Limits(10**9, 10**9, 10**9)


def main(
    laps: Annotated[int, typer.Option(help="The past begins after twenty-four.")] = 30,
    sessions: Annotated[int, typer.Option(help="How many, each drawn anew.")] = 4,
    lenses: Annotated[bool, typer.Option(help="Lenses and clocks are estimated, too.")] = False,
) -> list[Row]:
    """Hold a map with a summarised past against the solution over everything."""
    options = _LENSES if lenses else ""
    lap_s = Corridor(_CAMERAS, 0.0).lap_s
    corridor = Corridor(_CAMERAS, laps * lap_s, pictures_hz=1.0, camera_options=options)
    found = [np.concatenate(list(_errors(corridor, limits, sessions))) for limits in (LIVE, _NEVER)]
    return list(_rows(f"{sessions} × {laps} laps", *found))


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
    """By camera of each session: the squared errors of its position, m², and orientation, rad²,
    and of both by their covariance and number."""
    truths = [corridor.camera(index) for index in range(corridor.cameras)]
    for seed in range(sessions):
        pipeline = Pipeline(
            corridor.inputs, is_live=False, solver=SlowSolver(corridor.inputs, limits=limits)
        )
        replayed(pipeline, corridor.messages(seed=seed))
        pipeline.finish()
        cameras, rows = pipeline.results().network.cameras, []
        for index, truth in enumerate(truths):
            camera = cameras[f"c{index}"]
            assert camera.map_from_camera is not None, (seed, index, camera.undetermined)
            error = camera.map_from_camera.pose.difference(truth)
            by_covariance = error @ np.linalg.solve(camera.covariance_matrix, error) / 6
            rows.append((np.sum(error[:3] ** 2), np.sum(error[3:] ** 2), by_covariance))
        has_past = pipeline.past is not None
        assert has_past == (limits is LIVE), "there is no past yet; drive on for longer"
        typer.echo(f"session {seed}, past {has_past}: {np.mean(rows, axis=0)}", err=True)
        yield np.array(rows)
