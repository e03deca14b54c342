"""Drives before rolling shutters, for every estimator, offline and live."""

from pathlib import Path

import pytest

from benchmarks.study.disturbance import Disturbance
from benchmarks.study.in_memory import Simulated, simulated
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.site.config import Site, parse_site
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


# Two robots with one target; only one of them drives past the camera.
ALIKE = """
site = "hall"
hold_first = 0.6
hold_last = 0.2

[cameras.c1]
position = [0.0, -2.4, 1.5]
yaw = 90.0
pitch = 20.0
rate = 3.0
sigma = 0.02

[robots.r1]
waypoints = [[-1.2, 0.0], [1.2, 0.0]]

[robots.r2]
waypoints = [[6.0, 6.0], [6.0, 6.1]]
"""


def site_of(drive: Simulated, estimator: str, line_delay_s: float) -> Site:
    lines = ['site = "hall"', 'target = "target.toml"']
    for name in drive.world.cameras:
        lines += [f"[cameras.{name}]", f'source = "sim://{name}"', f"line_delay = {line_delay_s}"]
        lines += ["time_offset_sigma = 0.02"] if estimator != "particle" else []
    for name in drive.world.robots:
        lines += [f"[robots.{name}]", 'port = "loop://"']
    lines += ["[fusion]", f'estimator = "{estimator}"']
    return parse_site("\n".join(lines), directory=Path())


def worked_out(drive: Simulated, site: Site, *, is_live: bool) -> Pipeline:
    world = drive.world
    targets = {name: world.target(name) for name in world.robots}
    inputs = Inputs(site, targets, dict(drive.lenses))
    pipeline = Pipeline(inputs, is_live=is_live)
    for node, message in drive.messages:
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance(message.stamp_ns if is_live else None)
    pipeline.finish()
    return pipeline


def chi2_per_dof(drive: Simulated, estimator: str, line_delay_s: float, *, is_live: bool) -> float:
    """Of a session in which both cameras are located."""
    pipeline = worked_out(drive, site_of(drive, estimator, line_delay_s), is_live=is_live)
    network = pipeline.results().network
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


def test_robots_that_look_alike_are_told_apart_by_a_rolling_shutter_too(tmp_path: Path) -> None:
    (tmp_path / "hall.toml").write_text(ALIKE, encoding="utf-8")
    world = load_world(str(tmp_path / "hall.toml"), seed=1)
    alike = simulated(world, Disturbance(line_delay_s=LINE_DELAY_S))
    rms_px = {}
    for line_delay_s in (LINE_DELAY_S, 0.0):
        pipeline = worked_out(alike, site_of(alike, "smoother", line_delay_s), is_live=False)
        camera = pipeline.results().network.cameras["c1"]
        assert camera.sightings > 0
        # Taken for a global shutter, pictures in a turn contradict the others: some may be wrong.
        most = 0 if line_delay_s == LINE_DELAY_S else 0.2 * camera.sightings
        assert camera.rejected <= most
        assert camera.reprojection_rms is not None
        rms_px[line_delay_s] = camera.reprojection_rms
    assert rms_px[0.0] > 1.1 * rms_px[LINE_DELAY_S]
