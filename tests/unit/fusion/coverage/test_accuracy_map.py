"""The map over a floor: what its figures mean, what planners get of it, when it is new."""

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.networks import located

from benchmarks.fusion.accuracy_map import drawn, hall
from benchmarks.study.session import inputs_of
from trigpoint.contract.coverage import NOT_CORRECTED, UNKNOWN
from trigpoint.contract.messages import OccupancyGrid
from trigpoint.fusion.coverage.accuracy_map import (
    NOBODY,
    AccuracyMap,
    accuracy_map,
    grid_values,
    middle,
)
from trigpoint.fusion.coverage.announced import AnnouncedMap
from trigpoint.fusion.coverage.floor import Floor, floor_of
from trigpoint.fusion.coverage.known_network import KnownNetwork, carried_by, known_network
from trigpoint.fusion.estimators.results import Results
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import (
    Network,
    PoseRecord,
    Statistics,
)

WORLD = hall(1, "charuco")
INPUTS = inputs_of(WORLD)
NOWHERE = np.zeros((0, 2))


def covariance(cameras: int) -> Array:
    """Millimetres and tenths of milliradians, much of it common to all cameras."""
    random = np.random.default_rng(7)
    each = np.tile([2e-3] * 3 + [4e-4] * 3, cameras)
    common = np.tile(np.diag([2e-3] * 3 + [4e-4] * 3), (cameras, 1))
    mixed = 0.3 * random.normal(size=(6 * cameras, 6 * cameras)) / np.sqrt(6 * cameras)
    root = np.hstack([common, each[:, None] * (mixed + 0.3 * np.eye(6 * cameras))])
    return root @ root.T


def network_of(*names: str) -> Network:
    joint = covariance(len(names))
    cameras = {}
    for index, name in enumerate(names):
        camera = WORLD.cameras[name]
        known = {"lens": camera.model, "sightings": 9, "reprojection_rms": 0.15}
        cameras[name] = located(camera.map_from_camera, joint, index, **known)
    return Network("hall", "uuid", "smoother", cameras, {}, Statistics(1.0, 3))


def known(*names: str) -> KnownNetwork:
    return known_network(network_of(*names), covariance(len(names)))


[CARRIED] = carried_by(INPUTS.site.robots, INPUTS.targets, network_of("c1"))


def coarse_map(network: KnownNetwork) -> AccuracyMap:
    floor = floor_of(known("c1", "c2", "c3"), (CARRIED,), NOWHERE, cell_m=0.5)
    return accuracy_map(network, CARRIED, floor, NOWHERE)


@pytest.fixture(scope="module")
def found() -> AccuracyMap:
    return coarse_map(known("c1", "c2", "c3"))


def test_realised_errors_are_as_large_as_the_map_says() -> None:
    names = ("c1", "c2", "c3")
    results = Results(network_of(*names), covariance(3), {})
    realised = drawn(INPUTS, results, 200, 5, times=2)
    first, second = np.split(realised.stated_m, 2)
    assert np.array_equal(first, second)
    errors_m = realised.error_m[np.isfinite(realised.error_m)]
    assert len(set(errors_m.tolist())) == len(errors_m)
    assert realised.losses_right >= 0.99
    assert len(realised.ratios) > 150
    # Of a Rayleigh's or a half-normal's errors 95 % lie within; their medians are 0.48 and 0.34.
    assert 0.90 <= np.mean(realised.ratios <= 1.0) <= 0.985
    assert 0.30 <= np.median(realised.ratios) <= 0.52


def test_a_failed_camera_costs_what_a_map_without_it_lacks(found: AccuracyMap) -> None:
    joint = covariance(3)[np.ix_([*range(6), *range(12, 18)], [*range(6), *range(12, 18)])]
    eyes = known("c1", "c2", "c3").eyes
    failed = coarse_map(KnownNetwork((eyes[0], eyes[2]), joint))
    np.testing.assert_allclose(found.without[1], failed.error_m, rtol=1e-5)
    lost = found.area_m2(np.inf) - failed.area_m2(np.inf)
    assert found.lost_m2(1, np.inf) == pytest.approx(lost)
    assert lost > 1.0


def test_the_worst_camera_is_the_one_whose_failure_costs_most(found: AccuracyMap) -> None:
    for cell in np.flatnonzero(np.isfinite(found.error_m)).tolist():
        worst = int(found.worst_camera[cell])
        costs = found.without[:, cell]
        assert found.without_worst_m[cell] == costs.max()
        assert worst == NOBODY or costs[worst] == costs.max()
    assert set(found.worst_camera.tolist()) == {NOBODY, 0, 1, 2}


def test_the_middle_heading_is_no_better_than_half_of_the_others(found: AccuracyMap) -> None:
    errors = np.array([[1.0, 2, 3, 4], [np.inf, np.inf, 1, 1], [np.inf, 1, 2, 3]])
    assert middle(errors).tolist() == [3.0, np.inf, 3.0]
    assert np.all(found.best_m <= found.error_m)
    assert np.all(found.error_m <= found.worst_m)


def test_more_cameras_see_more(found: AccuracyMap) -> None:
    alone = coarse_map(known("c1"))
    assert alone.area_m2(np.inf) < found.area_m2(np.inf)
    assert found.seen_m2(0) == pytest.approx(alone.seen_m2(0))
    assert found.cameras.max() >= 2
    assert alone.cameras.max() == 1


def test_a_planner_gets_millimetres(found: AccuracyMap) -> None:
    values = grid_values([found])
    corrected = np.isfinite(found.error_m)
    assert np.array_equal(values[corrected], np.minimum(1000 * found.error_m[corrected] // 1, 99))
    assert set(values[~found.is_floor].tolist()) == {UNKNOWN}
    assert set(values[found.is_floor & ~corrected].tolist()) == {NOT_CORRECTED}


def test_of_two_targets_a_planner_gets_the_worse(found: AccuracyMap) -> None:
    nothing = replace(found, by_heading=np.full_like(found.by_heading, np.inf))
    both = grid_values([found, nothing])
    assert set(both[found.is_floor].tolist()) == {NOT_CORRECTED}


def test_floor_that_was_driven_is_floor_though_no_camera_sees_it() -> None:
    driven = np.array([[30.0, 30.0]])
    floor = floor_of(known("c1"), (CARRIED,), driven, cell_m=0.5)
    there = accuracy_map(known("c1"), CARRIED, floor, driven)
    values = grid_values([there])
    near = floor.near(driven, 0.4)
    assert near.any()
    assert set(values[near].tolist()) == {NOT_CORRECTED}


def test_a_large_floor_has_larger_cells() -> None:
    floor = floor_of(known("c1"), (CARRIED,), np.array([[0.0, 0], [90, 90]]), most_cells=10_000)
    assert floor.rows * floor.columns <= 11_000
    assert floor.cell_m == pytest.approx(1.0)
    assert Floor((0.0, 0.0), 0.5, 2, 3).centres[-1].tolist() == [1.25, 0.75]


def test_a_map_is_announced_again_only_where_the_network_changed_by_more_than_matters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trigpoint.fusion.coverage.announced.MOST_CELLS", 2_000)
    announced = AnnouncedMap(INPUTS.site, INPUTS.targets)
    first = network_of("c2")
    way = Pose.planar([3.0, 3.1], [2.0, 2.0], [0.0, 0.0])
    ways = {"r1": (np.array([5, 7]), way)}
    grid = announced.anew(first, covariance(1), ways)
    assert grid is not None
    assert (grid.frame_id, grid.stamp_ns) == ("map", 7)
    assert {-1, 100} <= set(np.unique(grid.values).tolist())
    assert announced.anew(first, 1.2 * covariance(1), ways) is None
    assert announced.anew(first, 2.0 * covariance(1), ways) is not None
    assert announced.anew(moved(first, 0.02), 2.0 * covariance(1), ways) is None
    assert announced.anew(moved(first, 0.08), 2.0 * covariance(1), ways) is not None
    assert announced.anew(network_of("c2", "c3"), covariance(2), ways) is not None


def test_floor_that_is_driven_anew_is_announced_and_stays_floor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trigpoint.fusion.coverage.announced.MOST_CELLS", 10_000)
    announced = AnnouncedMap(INPUTS.site, INPUTS.targets)

    def drive(x: float) -> OccupancyGrid | None:
        way = {"r1": (np.array([5]), Pose.planar([x], [-9.0], [0.0]))}
        return announced.anew(network_of("c2"), covariance(1), way)

    assert drive(0.0) is not None
    assert drive(0.2) is None
    assert drive(9.0) is not None
    assert drive(0.0) is None  # it is floor from before
    last = drive(18.0)
    assert last is not None
    driven = np.array([[0.0, -9.0], [9.0, -9.0], [18.0, -9.0]]) - last.origin.translation[:2]
    columns, rows = (driven / last.cell_m).astype(int).T
    assert last.values[rows, columns].tolist() == [NOT_CORRECTED] * 3


def moved(network: Network, by_m: float) -> Network:
    """With its only camera elsewhere."""

    [(name, record)] = network.cameras.items()
    assert record.map_from_camera is not None
    pose = record.map_from_camera.pose
    there = PoseRecord.of(Pose(pose.rotation, pose.translation + np.array([by_m, 0.0, 0.0])))
    other = msgspec.structs.replace(record, map_from_camera=there)
    return msgspec.structs.replace(network, cameras={name: other})


def test_nothing_is_announced_where_no_camera_is_located() -> None:
    announced = AnnouncedMap(INPUTS.site, INPUTS.targets)
    empty = Network("hall", "uuid", "smoother", {}, {}, Statistics(None, 0))
    assert announced.anew(empty, np.zeros((0, 0)), {}) is None
