"""A map whose past is bounded: it knows as much as one that keeps everything, and goes on from its
files."""

import logging
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from support.builders import make_site
from support.fusion.drives import (
    EPOCH_NS,
    STEP_S,
    Plan,
    RobotPlan,
    Session,
    circle,
    lab_cameras,
    lab_plan,
    make_session,
    offline,
    pushed,
    with_moved,
)
from support.fusion.networks import apart_sigmas
from support.fusion.solvers import SlowSolver

from trigpoint.base.clock import SystemClock, to_ns
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import PoseEstimate
from trigpoint.fusion.association.explanation import Explanation
from trigpoint.fusion.checkpoint import PAST, full_files, has_map
from trigpoint.fusion.estimators.registry import ESTIMATORS
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.estimators.smoother.batch import BatchSolution
from trigpoint.fusion.estimators.smoother.settled_past import Limits
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.map_storage import MapStorage
from trigpoint.fusion.model.past import Past
from trigpoint.fusion.past_file import load_past, save_past
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.replaying import Replay
from trigpoint.fusion.solver.filter import Filter
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.tools.simulation.sight.targets import target_of

FEW = Limits(sightings=25)
STOP_S = 38.0
ESTIMATED = 'intrinsics = "estimate"\ntime_offset_sigma = 0.01'


@pytest.fixture(scope="module")
def drive() -> Session:
    """Two rounds past cameras whose lenses and clocks are estimated."""
    return make_session(lab_plan(cameras=lab_cameras(3, more=ESTIMATED), seconds=42.0))


@pytest.fixture(scope="module")
def everything(drive: Session) -> Results:
    """What all of it tells."""
    return offline(drive)


class Live:
    """A live pipeline with little memory, fed with a session. `storage`: of its messages, where
    they are stored; `chi2`: of each correction, in the plane; `most`: sightings that it held."""

    def __init__(
        self, session: Session, past: Past | None = None, storage: MapStorage | None = None
    ) -> None:
        inputs = replace(session.inputs, past=past)
        self.session, self.storage = session, storage
        self.solver = SlowSolver(inputs, limits=FEW)
        self.pipeline = Pipeline(inputs, is_live=past is None, solver=self.solver)
        self.chi2: list[float] = []
        self.most = 0

    def feed(self, since_s: float = 0.0, until_s: float = np.inf) -> "Live":
        """Feed it with what was recorded between these times."""
        for node, message in self.session.messages:
            if since_s <= (message.stamp_ns - EPOCH_NS) / 1e9 < until_s:
                self._take(node, message)
        return self

    def _take(self, node: str, message: Input) -> None:
        self.pipeline.push(node, message)
        if self.storage is not None:
            key = INPUT_TOPICS[type(message)].key("lab", node)
            assert self.storage.store(key, cdr.encode(message), message) == 0
        for output in self.pipeline.advance(message.stamp_ns + to_ns(0.02)):
            if output.topic is topics.CORRECTION:
                assert isinstance(output.message, PoseEstimate)
                self.chi2.append(self._chi2(output.message))
        if self.storage is not None:
            self.storage.settle(self.pipeline.past)
        self.most = max(self.most, len(self.solver.data.entries))

    def _chi2(self, correction: PoseEstimate) -> float:
        plane = [0, 1, 5]
        truth = self.session.map_from_base("r1", correction.stamp_ns)
        error = correction.pose.difference(truth)[plane]
        return float(error @ np.linalg.solve(correction.covariance[np.ix_(plane, plane)], error))

    def network(self) -> Network:
        """What it knows at the end."""
        self.pipeline.finish()
        while not self.pipeline.reports.is_answered:
            self.pipeline.advance()
        return self.pipeline.results().network


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the drive was stored until STOP_S."""
    return tmp_path_factory.mktemp("map")


@pytest.fixture(scope="module")
def bounded(drive: Session, folder: Path) -> Live:
    """The drive taken in with little memory, and stored in the folder at first."""
    storage = opened(folder)
    live = Live(drive, storage=storage).feed(until_s=STOP_S)
    storage.close()
    live.storage = None
    return live.feed(since_s=STOP_S)


def opened(folder: Path, past: Past | None = None) -> MapStorage:
    return MapStorage(folder, make_site(), SystemClock(), knows=lambda _: True, past=past, most=200)


def assert_as_much_is_known(network: Network, everything: Network) -> None:
    """Within a quarter of a sigma, and sigmas within a tenth."""
    for name, whole in everything.cameras.items():
        mine = network.cameras[name]
        assert mine.status == "located"
        assert (mine.sightings, mine.confirmed) == (whole.sightings, whole.confirmed)
        np.testing.assert_allclose(apart_sigmas(mine, whole), 0.0, atol=0.25)
        sigmas = [np.sqrt(np.diagonal(each.covariance_matrix)) for each in (mine, whole)]
        np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=0.1)
        assert mine.intrinsics is not None
        assert whole.intrinsics is not None
        assert abs(mine.intrinsics.k[0] - whole.intrinsics.k[0]) < 0.25 * whole.intrinsics.sigma.fx
        assert abs(mine.time_offset - whole.time_offset) < 0.25 * whole.time_offset_sigma


def test_what_is_not_kept_is_known(bounded: Live, everything: Results) -> None:
    past = bounded.pipeline.past
    assert past is not None
    assert (past.end_ns - EPOCH_NS) / 1e9 > 15
    network = bounded.network()
    assert network.map_id == everything.network.map_id
    assert_as_much_is_known(network, everything.network)


def test_what_is_kept_is_bounded(bounded: Live) -> None:
    # Until a quarter of a second after its moment a sighting is on its way to the solver.
    assert bounded.most < 3 * FEW.sightings + 10
    entries, track = bounded.solver.data.entries, bounded.pipeline._data.tracks["r1"]
    assert len(entries) < 3 * FEW.sightings
    assert (track.last_ns - track.first_ns) / 1e9 < 30


def test_corrections_stay_honest(bounded: Live) -> None:
    assert len(bounded.chi2) > 80
    assert 0.5 < np.mean(bounded.chi2) / 3 < 1.6


def test_a_long_recording_is_worked_out_part_by_part(
    drive: Session, everything: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the robot's whole path is there."""
    monkeypatch.setitem(ESTIMATORS, "smoother", "support.fusion.solvers:FrugalSmoother")
    pipeline = pushed(drive.inputs, drive.messages)
    assert pipeline.past is not None
    results = pipeline.results()
    assert_as_much_is_known(results.network, everything.network)
    stamps_ns, whole_ns = results.trajectories["r1"][0], everything.trajectories["r1"][0]
    assert (stamps_ns[0], stamps_ns[-1]) == (whole_ns[0], whole_ns[-1])
    assert np.diff(stamps_ns).min() > 0
    assert np.diff(stamps_ns).max() <= to_ns(0.15)
    # What came later does not mend it: half as far again.
    assert np.all(path_errors(drive, results) < 1.5 * path_errors(drive, everything))


def path_errors(session: Session, results: Results) -> Array:
    """Root mean squares of how far a path is off in x and y together, m, and in heading, rad."""
    stamps_ns, poses = results.trajectories["r1"]
    rows = np.flatnonzero((stamps_ns - EPOCH_NS) % to_ns(STEP_S) == 0)
    assert len(rows) > 100
    truth = session.truth["r1"][(stamps_ns[rows] - EPOCH_NS) // to_ns(STEP_S)]
    errors = poses[rows].difference(truth)
    return np.sqrt([np.mean(errors[:, :2] ** 2), np.mean(errors[:, 5] ** 2)])


def test_where_what_is_left_cannot_be_solved_the_past_holds(
    drive: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = BatchSolution.solve

    def solve_before(batch: BatchSolution, explanation: Explanation) -> Filter:
        if batch.data.past is not None:
            raise np.linalg.LinAlgError("singular")
        return solve(batch, explanation)

    monkeypatch.setattr(BatchSolution, "solve", solve_before)
    monkeypatch.setitem(ESTIMATORS, "smoother", "support.fusion.solvers:FrugalSmoother")
    pipeline = pushed(drive.inputs, drive.messages)
    assert any("could not be solved" in note for note in pipeline.notes)
    results = pipeline.results()
    assert results.network.located == ["c1", "c2", "c3"]
    nees = drive.error(results).nees
    assert nees is not None
    assert nees < 3
    assert np.all(np.diff(results.trajectories["r1"][0]) > 0)


def test_moved_cameras_are_noticed_before_and_after_a_past() -> None:
    """c2 is moved in what becomes the past, and c3 long after it."""
    robots = {"r1": RobotPlan(circle(), target_of("charuco"))}
    plan = Plan(lab_cameras(3), robots, seconds=58.0)
    truths = {name: camera.map_from_camera for name, camera in plan.cameras.items()}
    session = make_session(plan)
    for name, at_s in (("c2", 8.0), ("c3", 36.0)):
        truths[name] = Pose.planar(0.2, 0.0, 0.0) @ truths[name]
        session = with_moved(session, name, truths[name], at_s)
    live = Live(session).feed()
    network, past = live.network(), live.pipeline.past
    assert past is not None
    assert past.end_ns > EPOCH_NS + to_ns(20.0)
    for name, truth in truths.items():
        camera = network.cameras[name]
        assert camera.map_from_camera is not None, (name, camera.undetermined)
        error = camera.map_from_camera.pose.difference(truth)
        assert error @ np.linalg.solve(camera.covariance_matrix, error) < 6 * 5.0, name
        assert len(camera.earlier) == (name != "c1"), name


def test_a_map_goes_on_from_its_files(
    bounded: Live, drive: Session, everything: Results, folder: Path
) -> None:
    stored = sum(message.stamp_ns < EPOCH_NS + to_ns(STOP_S) for _, message in drive.messages)
    assert 0 < len(full_files(folder)) < stored // 200  # the oldest are gone
    past = load_past(folder / PAST, drive.inputs.site, drive.inputs.targets)
    assert past is not None
    again, storage = Live(drive, past), opened(folder, past)
    replay = Replay(again.pipeline)
    for some in storage.read(1024):
        for key, message in some:
            replay.take(topics.node_of(key), message)
    replay.flush()
    storage.close()
    again.pipeline.resumed()
    network = again.feed(since_s=STOP_S).network()
    assert network.map_id == everything.network.map_id
    assert_as_much_is_known(network, everything.network)


def test_a_new_map_begins_without_the_past(bounded: Live, tmp_path: Path) -> None:
    past, site = bounded.pipeline.past, bounded.session.inputs.site
    assert past is not None
    save_past(tmp_path / PAST, past, site)
    storage = MapStorage(tmp_path, site, SystemClock(), knows=lambda _: True, past=past)
    storage.restart()
    storage.close()
    assert not has_map(tmp_path)
    assert (tmp_path / "past.1.bin").exists()


def test_a_past_is_read_as_it_was_written(bounded: Live, tmp_path: Path) -> None:
    past, inputs = bounded.pipeline.past, bounded.session.inputs
    assert past is not None
    save_past(tmp_path / PAST, past, inputs.site)
    found = load_past(tmp_path / PAST, inputs.site, inputs.targets)
    assert found is not None
    assert found.known.values.keys() == past.known.values.keys()
    np.testing.assert_array_equal(found.known.information, past.known.information)
    for name, pose in past.known.poses.items():
        np.testing.assert_array_equal(found.known.poses[name].difference(pose), 0.0)
    assert (found.since_ns, found.cameras) == (past.since_ns, past.cameras)
    assert (found.map_since_ns, found.epoch_ns) == (past.map_since_ns, past.epoch_ns)
    assert found.lenses == past.lenses


def test_of_a_camera_that_the_site_lost_nothing_is_taken(bounded: Live, tmp_path: Path) -> None:
    """The others stay as uncertain as they are."""
    past, inputs = bounded.pipeline.past, bounded.session.inputs
    assert past is not None
    save_past(tmp_path / PAST, past, inputs.site)
    fewer = make_session(lab_plan(cameras=lab_cameras(2, more=ESTIMATED), seconds=1.0)).inputs
    found = load_past(tmp_path / PAST, fewer.site, inputs.targets)
    assert found is not None
    assert list(found.known.poses) == ["c1", "c2"]
    assert {name for _, name in found.known.values} == {"c1", "c2"}
    np.testing.assert_allclose(
        found.known.covariance[:12, :12], past.known.covariance[:12, :12], rtol=1e-6, atol=1e-15
    )


@pytest.mark.parametrize("at", [3, 22, 60])
def test_a_damaged_past_is_said_and_kept(
    bounded: Live, tmp_path: Path, caplog: pytest.LogCaptureFixture, at: int
) -> None:
    past, inputs = bounded.pipeline.past, bounded.session.inputs
    assert past is not None
    save_past(tmp_path / PAST, past, inputs.site)
    data = bytearray((tmp_path / PAST).read_bytes())
    data[at] ^= 1
    (tmp_path / PAST).write_bytes(data)
    with caplog.at_level(logging.ERROR):
        assert load_past(tmp_path / PAST, inputs.site, inputs.targets) is None
    assert "is damaged" in caplog.text
    assert (tmp_path / "past.1.bin").read_bytes() == data
