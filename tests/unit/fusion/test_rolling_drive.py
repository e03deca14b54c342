"""Drives before rolling shutters, for every estimator, offline and live."""

from pathlib import Path

import pytest

from trigpoint.config import Site, parse_site
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.results import Results
from trigpoint.messages import Odometry
from trigpoint.tools.simulation.disturbance import Disturbance
from trigpoint.tools.simulation.memory import Simulated, simulated
from trigpoint.tools.simulation.world import load_world

LINE_DELAY_S = 60e-6
WORLD = """
site = "hall"
hold_first = 0.6
hold_last = 0.2

[cameras.c1]
position = [0.2, -1.7, 1.5]
yaw = 90.0
pitch = 20.0
rate = 2.0
sigma = 0.05

[cameras.c2]
position = [3.1, 1.0, 1.5]
yaw = 180.0
pitch = 20.0
rate = 2.0
phase = 0.1
sigma = 0.05

[robots.r1]
waypoints = [[-1.2, 0.0], [1.2, 0.0], [1.2, 2.0]]
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    file = tmp_path_factory.mktemp("rolling") / "hall.toml"
    file.write_text(WORLD, encoding="utf-8")
    return simulated(load_world(str(file), seed=1), Disturbance(line_delay_s=LINE_DELAY_S))


def site_of(drive: Simulated, estimator: str, line_delay_s: float) -> Site:
    lines = ['site = "hall"', 'target = "target.toml"']
    for name in drive.truth.world.cameras:
        lines += [f"[cameras.{name}]", f'source = "sim://{name}"', f"line_delay = {line_delay_s}"]
        lines += ["time_offset_sigma = 0.02"] if estimator != "particle" else []
    lines += ["[robots.r1]", 'port = "loop://"', f'[fusion]\nestimator = "{estimator}"']
    return parse_site("\n".join(lines), directory=Path())


def worked_out(drive: Simulated, site: Site, *, is_live: bool) -> Results:
    world = drive.truth.world
    inputs = Inputs(site, {"r1": world.target("r1")}, dict(drive.truth.lenses))
    pipeline = Pipeline(inputs, is_live=is_live)
    for node, message in drive.messages:
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance(message.stamp_ns if is_live else None)
    pipeline.finish()
    return pipeline.results()


def chi2_per_dof(drive: Simulated, estimator: str, line_delay_s: float, *, is_live: bool) -> float:
    """Of a session in which both cameras are located."""
    network = worked_out(drive, site_of(drive, estimator, line_delay_s), is_live=is_live).network
    assert network.located == ["c1", "c2"]
    assert network.statistics.chi2_per_dof is not None
    return network.statistics.chi2_per_dof


@pytest.mark.parametrize("is_live", [False, True])
@pytest.mark.parametrize("estimator", ["smoother", "ekf"])
def test_what_a_rolling_shutter_saw_fits_as_well_as_its_noise(
    drive: Simulated, estimator: str, is_live: bool
) -> None:
    # Some 1,900 coordinates: three sigmas of χ².
    assert abs(chi2_per_dof(drive, estimator, LINE_DELAY_S, is_live=is_live) - 1) < 0.1


@pytest.mark.parametrize("estimator", ["smoother", "ekf"])
def test_taken_for_a_global_shutter_it_does_not_fit(drive: Simulated, estimator: str) -> None:
    assert chi2_per_dof(drive, estimator, 0.0, is_live=False) > 1.2
