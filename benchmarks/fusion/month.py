"""Live fusion day after day: what grows with the age of a map?

    python -m benchmarks month [--days D] [--hours H] [--every S]

Each day a robot is switched on at the same place, its odometry anew, and drives H hours past thirty
cameras with 1 sighting a second and odometry at 20 Hz; at night nothing comes. It is fed as `load`
feeds a day, and the solver is waited for every S seconds of it. Memory and checkpoint are the most
of a day at these moments, by what is resident (of the estimator's, some 60 MB are eight hours'
drawn poses). A solution is the solver's processor time of the day by the number of its solutions, a
start its work until it has read the checkpoint as it is at the day's end, and an error that of the
cameras' positions; of its squares by their covariances, a number, 1 is to be expected.
"""

from contextlib import closing
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct

from benchmarks.table import Row
from benchmarks.timing import in_new_process
from trigpoint.base.clock import to_ns
from trigpoint.fusion.live.memory import return_large_arrays
from trigpoint.fusion.live.solver_process import SolverProcess

from .corridor import Corridor
from .load import Drive, Load, turns
from .restart import read_s

_CAMERAS, _PICTURES_HZ = 30, 20.0 / 14  # of which 0.7 see the robot
_DAY_NS = to_ns(24 * 3600.0)


class Day(Struct, frozen=True):
    """What a day came to: sightings, and what is above."""

    number: int
    sightings: int
    solutions: int
    estimator_mb: float
    solver_mb: float
    checkpoint_mb: float
    thread_s: float
    solution_s: float
    pasts: int
    start_s: float
    located: int
    error_mm: float
    by_covariance: float

    def __str__(self) -> str:
        return (
            f"day {self.number}: {self.sightings} sightings; "
            f"{self.estimator_mb:.0f} + {self.solver_mb:.0f} MB, checkpoint "
            f"{self.checkpoint_mb:.1f} MB; {self.solutions} solutions of {self.solution_s:.2f} s, "
            f"thread {self.thread_s:.0f} s; {self.pasts} summaries; a start {self.start_s:.2f} s; "
            f"{self.located} located, off by {self.error_mm:.1f} mm, squares by covariance "
            f"{self.by_covariance:.2f}"
        )


def main(
    days: Annotated[int, typer.Option(help="How many.")] = 30,
    hours: Annotated[float, typer.Option(help="Of driving a day.")] = 8.0,
    every: Annotated[float, typer.Option(help="Seconds of it until the solver is heard.")] = 30.0,
) -> list[Row]:
    """Drive for days, and say what each came to."""
    found = in_new_process(_driven, days, hours, to_ns(every))
    second, last = found[min(1, len(found) - 1)], found[-1]
    what, against = f"day {last.number}", f"day {second.number}"
    return [
        Row("month", f"{what}, {name}", unit, getattr(last, field), getattr(second, field), against)
        for name, unit, field in (
            ("the estimator's memory", "MB", "estimator_mb"),
            ("its solver's", "MB", "solver_mb"),
            ("the checkpoint", "MB", "checkpoint_mb"),
            ("a solution", "s", "solution_s"),
            ("a start", "s", "start_s"),
            ("error of a position", "mm", "error_mm"),
            ("squared errors by covariance", "1", "by_covariance"),
        )
    ]


def _driven(days: int, hours: float, every_ns: int) -> list[Day]:
    return_large_arrays()  # as the command does it
    corridor, solutions = Corridor(_CAMERAS, 3600 * hours, pictures_hz=_PICTURES_HZ), list[float]()
    solver = SolverProcess(corridor.inputs.data_set(), took=solutions.append)
    try:
        with (
            TemporaryDirectory() as folder,
            closing(Drive(Load(corridor), solver, Path(folder))) as drive,
        ):
            return [_day(drive, corridor, number, solutions, every_ns) for number in range(days)]
    finally:
        solver.close()


def _day(
    drive: Drive, corridor: Corridor, number: int, solutions: list[float], every_ns: int
) -> Day:
    drive.begin()
    solutions.clear()
    past, pasts, due_ns, stored_mb = drive.pipeline.past, 0, 0, [drive.stored_mb()]
    for now_ns, turn in turns(corridor, seed=number, later_ns=number * _DAY_NS):
        drive.take(now_ns, turn)
        if drive.pipeline.past is not past:
            past, pasts = drive.pipeline.past, pasts + 1
        if now_ns >= due_ns:
            drive.listen()
            drive.span.memory.append(drive.memory_mb())
            stored_mb.append(drive.stored_mb())
            due_ns = now_ns + every_ns
    estimator_mb, solver_mb = map(max, zip(*drive.span.memory, strict=True))
    located, error_mm, by_covariance = _errors(drive, corridor)
    day = Day(
        number=number + 1,
        sightings=drive.span.sightings,
        solutions=len(solutions),
        estimator_mb=estimator_mb,
        solver_mb=solver_mb,
        checkpoint_mb=max(stored_mb),
        thread_s=drive.span.spent_s,
        solution_s=drive.solver_s() / max(len(solutions), 1),
        pasts=pasts,
        start_s=_start_s(corridor, drive.folder),
        located=located,
        error_mm=error_mm,
        by_covariance=by_covariance,
    )
    typer.echo(str(day), err=True)
    return day


def _start_s(corridor: Corridor, folder: Path) -> float:
    """The work of a start until it has read a copy of the checkpoint."""
    with TemporaryDirectory() as other:
        copied = copytree(folder, Path(other) / "map")
        return in_new_process(read_s, corridor, copied)


def _errors(drive: Drive, corridor: Corridor) -> tuple[int, float, float]:
    """How many cameras are located, by how much their positions are off, mm, and the mean of the
    squares of that by covariance and number."""
    found, cameras = [], drive.pipeline.results().network.cameras
    for index in range(corridor.cameras):
        camera = cameras[f"c{index}"]
        if camera.map_from_camera is not None:
            truth = corridor.camera(index).translation
            error = camera.map_from_camera.pose.translation - truth
            spread = camera.covariance_matrix[:3, :3]
            found.append((error @ error, error @ np.linalg.solve(spread, error) / 3))
    if not found:
        return 0, float("nan"), float("nan")
    squared, by_covariance = np.mean(found, axis=0).tolist()
    return len(found), 1e3 * squared**0.5, by_covariance
