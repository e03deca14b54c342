"""Writes a calibration's page beside its files."""

from pathlib import Path

from trigpoint.base.errors import writing
from trigpoint.fusion.coverage.accuracy_map import AccuracyMap, accuracy_map
from trigpoint.fusion.coverage.announced import MOST_CELLS
from trigpoint.fusion.coverage.floor import DRIVEN_M, each_decimetre, floor_about
from trigpoint.fusion.coverage.known_network import carried_by, known_network
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.guidance.suggestions import Suggestion, next_poses
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.tools.networks.building_alignment import Alignment
from trigpoint.tools.networks.truth import NetworkError
from trigpoint.tools.report.calibration.facts import CalibrationResults
from trigpoint.tools.report.calibration.page import calibration_page

REPORT = "report.html"
_NEXT_POSES = 3
_CELL_M = 0.2
"""Of the page's map of corrections: a quarter of the cells that `coverage` works out."""


def write_report(
    pipeline: Pipeline,
    results: Results,
    error: NetworkError | None,
    alignment: Alignment,
    *,
    session: Path,
    folder: Path,
) -> None:
    """Write report.html to the folder of the results; raises OperationError if that fails."""
    page = calibration_page(
        CalibrationResults(
            network=results.network,
            covariance=results.covariance,
            trajectories=results.trajectories,
            residuals=pipeline.residuals(),
            left_out=pipeline.messages_left_out,
            notes=[*pipeline.notes, *results.doubts],
            suggestions=_next_poses(pipeline),
            corrected=_corrected(pipeline, results),
            error=error,
            noise=results.noise,
            contradicted=pipeline.arrivals.contradicted if results.network.located else "",
            building=alignment.building,
            building_problem=alignment.problem,
            session=str(session),
            folder=str(folder),
        )
    )
    with writing(folder / REPORT):
        (folder / REPORT).write_text(page, encoding="utf-8")


def _corrected(pipeline: Pipeline, results: Results) -> tuple[AccuracyMap, ...]:
    """How well robots would be corrected on the floor where they drove."""
    if not results.network.located or not results.trajectories:
        return ()
    known = known_network(results.network, results.covariance)
    driven = each_decimetre([poses.translation for _, poses in results.trajectories.values()])
    floor = floor_about(driven, cell_m=_CELL_M, most_cells=MOST_CELLS)
    wanted = floor.near(driven, DRIVEN_M)
    site = pipeline.site
    return tuple(
        accuracy_map(known, carried, floor, driven, wanted=wanted)
        for carried in carried_by(site.robots, pipeline.inputs.targets, results.network)
    )


def _next_poses(pipeline: Pipeline) -> tuple[Suggestion, ...]:
    world = pipeline.guidance_world()
    return tuple(next_poses(world, count=_NEXT_POSES)) if world is not None else ()
