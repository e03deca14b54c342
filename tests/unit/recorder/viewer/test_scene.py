"""What rerun is given of a site."""

import logging
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from support.builders import make_site, make_target
from support.viewer import SECOND, Rows, estimate

from trigpoint.base.errors import OperationError, RecordingError
from trigpoint.contract.messages import (
    CameraInfo,
    FaceSighting,
    Odometry,
    Picture,
    PoseEstimate,
    Sightings,
    Transform,
    Transforms,
)
from trigpoint.contract.topics import (
    CAMERA_INFO,
    CAMERA_POSE,
    IMAGE,
    ODOMETRY,
    ROBOT_POSE,
    SIGHTINGS,
    TF,
)
from trigpoint.geometry import CameraModel, Pose
from trigpoint.map.network import (
    CameraRecord,
    Network,
    PoseRecord,
    Statistics,
    encode_network,
)
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.session.recording import open_recording
from trigpoint.recorder.viewer import style
from trigpoint.recorder.viewer.columns import Columns, open_stream
from trigpoint.recorder.viewer.hull import outline
from trigpoint.recorder.viewer.review import write_rrd
from trigpoint.recorder.viewer.scene import Scene


@pytest.fixture
def rows() -> Rows:
    return Rows()


@pytest.fixture
def scene(rows: Rows) -> Scene:
    return Scene(make_site(cameras=2, robots=2), {}, rows)


def odometry(t: float, x: float, robot: str = "r1") -> Odometry:
    return Odometry(round(t * SECOND), f"{robot}/odom", f"{robot}/base", Pose.planar(x, 0, 0))


def placed(t: float, y: float, robot: str) -> Transforms:
    pose = Pose.planar(0.0, y, 0.0)
    return Transforms((Transform(round(t * SECOND), "map", f"{robot}/odom", pose),))


def drawn(rows: Rows, robot: str) -> np.ndarray:
    strips = [parts["strips"][0] for _, parts in rows.of(f"/map/robots/{robot}/dead_reckoning")]
    return np.concatenate(strips)


def sighting(t: float, camera: str = "c1") -> Sightings:
    pixels = np.array([[10, 10], [20, 10], [20, 20], [10, 20]], np.float32)
    face = FaceSighting("t", 1, np.arange(4, dtype=np.uint16), pixels, 0.2)
    return Sightings(round(t * SECOND), f"{camera}/optical", 640, 480, (face,))


def test_dead_reckoning_stays_where_the_first_word_of_fusion_put_it(
    scene: Scene, rows: Rows
) -> None:
    scene.add(ODOMETRY, "r2", odometry(1, 0.0, "r2"))
    assert not rows.of("/map/robots/r2/dead_reckoning")  # nobody knows yet where that is
    scene.add(TF, "", placed(1, 5.0, "r2"))
    scene.add(TF, "", placed(2, 9.0, "r2"))
    for t in range(2, 6):
        scene.add(ODOMETRY, "r2", odometry(t, float(t), "r2"))
    scene.finish()
    assert np.all(drawn(rows, "r2")[:, 1] == 5.0)
    assert drawn(rows, "r2")[0, 0] == 0.0  # what came before the word is drawn as well


def test_the_first_robot_needs_no_fusion(scene: Scene, rows: Rows) -> None:
    for t in range(20):
        scene.add(ODOMETRY, "r1", odometry(t, float(t)))
    scene.finish()
    assert drawn(rows, "r1")[-1].tolist() == [19.0, 0.0, 0.0]
    body = rows.of("/map/robots/r1/body")
    assert len(body) == 20


def test_drift_is_the_distance_between_the_two_paths(scene: Scene, rows: Rows) -> None:
    scene.add(TF, "", placed(0, 0.0, "r1"))
    scene.add(ODOMETRY, "r1", odometry(1, 2.0))
    scene.add(ROBOT_POSE, "r1", estimate(1, 2.5))
    ((_, parts),) = rows.of("/drift/r1")
    assert parts["scalars"] == [pytest.approx(50.0)]


def test_a_camera_is_in_the_map_only_once_it_is_located(scene: Scene, rows: Rows) -> None:
    scene.add(IMAGE, "c1", Picture(SECOND, "c1/optical", "jpeg", b"x"))
    assert rows.of("/pictures/c1")
    assert not [path for path, *_ in rows.rows if path.startswith("/map/")]
    scene.add(CAMERA_POSE, "c1", estimate(2, 1.0))
    scene.add(IMAGE, "c1", Picture(3 * SECOND, "c1/optical", "jpeg", b"y"))
    assert rows.of("/map/cameras/c1/frustum")[-1][1] == {"blob": [b"y"]}
    assert any("c1 located" in parts["text"][0] for _, parts in rows.of("/log"))


@pytest.mark.parametrize("picture_first", [True, False])
def test_sightings_are_drawn_on_their_own_picture(
    scene: Scene, rows: Rows, picture_first: bool
) -> None:
    scene.add(IMAGE, "c1", Picture(SECOND, "c1/optical", "jpeg", b"x"))
    picture = Picture(2 * SECOND, "c1/optical", "jpeg", b"y")
    both = [(IMAGE, picture), (SIGHTINGS, sighting(2))]
    for topic, message in both if picture_first else both[::-1]:
        scene.add(topic, "c1", message)
    scene.add(SIGHTINGS, "c1", sighting(2.1))  # the picture of 2 s is still the newest
    time_ns, parts = rows.of("/pictures/c1/corners")[-1]
    assert time_ns == 2 * SECOND
    assert len(parts["positions"]) == 4


def test_without_pictures_a_sighting_is_shown_for_a_second(scene: Scene, rows: Rows) -> None:
    scene.add(SIGHTINGS, "c1", sighting(1))
    scene.add(SIGHTINGS, "c1", sighting(5))
    shown = [(t, len(parts["positions"])) for t, parts in rows.of("/pictures/c1/corners")]
    assert shown == [(SECOND, 4), (2 * SECOND, 0), (5 * SECOND, 4)]


def test_strangers_are_counted(scene: Scene) -> None:
    scene.add(ODOMETRY, "r9", odometry(1, 0.0))
    assert scene.strangers == 1


def test_an_ellipsoid_has_the_covariances_axes() -> None:
    turn = Pose.planar(0, 0, 0.3).rotation
    covariance = turn @ np.diag([0.04**2, 0.02**2, 0.01**2]) @ turn.T
    half_sizes, axes = style.ellipsoid(covariance)
    again = axes @ np.diag((half_sizes / (style.SIGMAS_DRAWN * style.MAGNIFIED)) ** 2) @ axes.T
    assert again == pytest.approx(covariance)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_flat_ellipsoid_keeps_a_thickness() -> None:
    half_sizes, _ = style.ellipsoid(np.diag([0.01, 0.01, 0.0]))
    assert np.all(half_sizes > 0)


def test_an_outline_goes_around_every_corner() -> None:
    angles = np.linspace(0, 2 * math.pi, 7)[:-1]
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.concatenate([ring, 0.3 * ring])
    around = outline(points)
    assert len(around) == 7
    assert {tuple(p) for p in around.round(9)} == {tuple(p) for p in ring.round(9)}


@pytest.mark.parametrize("count", [1, 2])
def test_an_outline_of_few_corners_is_a_line(count: int) -> None:
    points = np.arange(2.0 * count).reshape(count, 2)
    assert {tuple(p) for p in outline(points)} == {tuple(p) for p in points}


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def test_a_whole_session_becomes_a_rerun_file(
    session_file: Path, story: list, tmp_path: Path
) -> None:
    path = tmp_path / "out" / "s.rrd"
    assert write_rrd(open_recording(session_file), path) == len(story)
    found = entities(path)
    for entity in (
        "/map/cameras/c1/frustum", "/map/uncertainty/c1", "/map/coverage/c1", "/pictures/c4/seen",
        "/map/robots/r1/corrected", "/map/robots/r1/dead_reckoning", "/map/robots/r1/particles",
        "/sigma/cameras/c1", "/drift/r1", "/log", "/legend", "/map/corrected",
    ):  # fmt: skip
        assert entity in found
    assert "/map/cameras/c4" not in found  # was never located
    assert len(RrdReader(path).blueprints()) == 1


def test_unsound_and_unknown_messages_are_left_out_and_said(
    session_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_recording(session_file)
    writer = McapWriter(tmp_path / "s.mcap")
    writer.attach("site.toml", source.attachments["site.toml"], "application/toml", time_ns=0)
    sound = list(source.samples([ODOMETRY]))
    for sample in sound:
        writer.add(ODOMETRY, sample.key, sample.payload, log_ns=sample.log_ns, published_ns=0)
    for key, payload in (
        ("lab/robot/r1/odom", b"garbage"),
        ("lab/robot/r9/odom", sound[0].payload),
        ("lab/robot/r1/mood", b"\0\1\0\0"),
    ):
        writer.add(ODOMETRY, key, payload, log_ns=source.end_ns, published_ns=0)
    writer.finish()
    with caplog.at_level(logging.WARNING):
        write_rrd(open_recording(tmp_path / "s.mcap"), tmp_path / "s.rrd")
    said = caplog.text
    assert "1 messages do not decode" in said
    assert "1 messages of cameras or robots that site.toml does not have" in said
    assert "lab/robot/r1/mood is not a key of the contract" in said
    assert "target.toml is not attached" in said
    assert "/map/robots/r1/dead_reckoning" in entities(tmp_path / "s.rrd")


def test_a_session_without_a_site_file_is_refused(tmp_path: Path, story: list) -> None:
    writer = McapWriter(tmp_path / "s.mcap")
    one = story[0]
    writer.add(one.topic, one.key, one.payload, log_ns=1, published_ns=1)
    writer.finish()
    with pytest.raises(RecordingError, match=r"no site\.toml"):
        write_rrd(open_recording(tmp_path / "s.mcap"), tmp_path / "s.rrd")


def test_a_place_that_cannot_be_written_is_named(session_file: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OperationError, match="cannot be written"):
        write_rrd(open_recording(session_file), tmp_path / "file" / "s.rrd")


def test_rows_of_different_components_do_not_mix(tmp_path: Path) -> None:
    stream = open_stream("lab", 0)
    stream.save(tmp_path / "s.rrd")
    columns = Columns(stream)
    columns.row("/a", 1, rr.Points3D, positions=[[0, 0, 0]])
    columns.row("/a", 2, rr.Points3D, positions=[[0, 0, 0]] * 2, labels=["x", "y"])
    columns.row("/a", 3, rr.Points3D, positions=[], labels=[])
    columns.flush()
    stream.disconnect()
    chunks = [c for c in RrdReader(tmp_path / "s.rrd").stream() if c.entity_path == "/a"]
    assert sorted(chunk.num_rows for chunk in chunks) == [1, 2]


def test_cameras_of_a_network_beside_the_session_are_shown(
    make_session: Callable[[list], Path], story: list, tmp_path: Path
) -> None:
    path = make_session([one for one in story if one.topic in (ODOMETRY, SIGHTINGS)])
    located = CameraRecord(
        "located",
        map_from_camera=PoseRecord.of(Pose.planar(1, 2, 3)),
        covariance=tuple(float(value) for value in (1e-4 * np.eye(6)).reshape(-1)),
    )
    cameras = {"c1": located, "c2": CameraRecord("unseen"), "c9": located}
    network = Network("lab", "id", "smoother", cameras, {}, Statistics(None, 0))
    (path.parent / "network.json").write_bytes(encode_network(network))
    write_rrd(open_recording(path), tmp_path / "s.rrd")
    found = entities(tmp_path / "s.rrd")
    assert "/map/cameras/c1/frustum" in found
    assert not {"/map/cameras/c2", "/map/cameras/c9"} & found


def test_a_frustums_picture_lies_around_its_principal_point(scene: Scene, rows: Rows) -> None:
    lens = CameraModel(640, 480, 500.0, 510.0, 300.0, 250.0)
    scene.add(CAMERA_INFO, "c1", CameraInfo(SECOND, "c1/optical", lens))
    scene.add(CAMERA_POSE, "c1", estimate(1, 0.0))
    ((_, pinhole),) = rows.of("/map/cameras/c1/frustum")
    (column,) = rr.Pinhole.columns(image_from_camera=pinhole["image_from_camera"])
    # What rerun is given is column-major: fx 0 0, 0 fy 0, cx cy 1.
    (numbers,) = column.as_arrow_array().to_pylist()
    assert np.ravel(numbers).tolist() == [500, 0, 0, 0, 510, 0, 300, 250, 1]


def test_a_sighting_that_contradicts_the_poses_is_red_and_in_the_log(
    scene: Scene, rows: Rows
) -> None:
    target = make_target()
    scene = Scene(make_site(), {"r1": target}, rows)
    lens = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0)
    forward = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # looks along the map's x
    place = Pose(forward, np.array([0.0, 0.0, 0.4]))
    scene.add(CAMERA_INFO, "c1", CameraInfo(0, "c1/optical", lens))
    scene.add(CAMERA_POSE, "c1", PoseEstimate(0, "map", place, 1e-6 * np.eye(6)))
    face = target.faces[0]
    for t in range(4):
        scene.add(ROBOT_POSE, "r1", estimate(t, 2.0, sigma=0.001))
    points = Pose.planar(2.0, 0.0, 0.0) @ face.base_from_face @ face.corners
    pixels = lens.project(place.inverse() @ points).astype(np.float32)
    ids = np.arange(len(pixels), dtype=np.uint16)
    for t, shift in ((1, 0.0), (2, 50.0)):
        found = FaceSighting("", 0, ids, pixels + np.array([shift, 0], np.float32), 0.1)
        scene.add(SIGHTINGS, "c1", Sightings(t * SECOND, "c1/optical", 640, 480, (found,)))
    rejected = dict(rows.of("/pictures/c1/rejected"))
    assert not rejected[SECOND]["strips"]
    assert len(rejected[2 * SECOND]["strips"]) == 2
    assert [parts["scalars"] for _, parts in rows.of(f"{style.RESIDUALS}/c1")] == [
        pytest.approx([0.0], abs=0.01),
        pytest.approx([50.0], abs=0.01),
    ]
    said = [parts["text"][0] for _, parts in rows.of(style.LOG)]
    assert any("c1: a sighting is 50 px" in line for line in said)


def test_rates_are_plotted(scene: Scene, rows: Rows) -> None:
    for i in range(61):
        scene.add(ODOMETRY, "r1", odometry(1 + i / 20, 0.0))
    assert [parts["scalars"] for _, parts in rows.of(f"{style.RATES}/r1")] == [
        pytest.approx([20.0], abs=0.5)
    ]


def test_many_cameras_have_their_names_alone(rows: Rows) -> None:
    for count, expected in ((8, "c1 ±"), (9, "c1")):
        scene = Scene(make_site(cameras=count), {}, rows)
        scene.add(CAMERA_POSE, "c1", estimate(1, 0.0))
        label = rows.of("/map/names/c1")[-1][1]["labels"][0]
        assert label.startswith(expected)
        assert ("±" in label) == (count == 8)


def test_a_sigma_that_nobody_can_see_is_said_to_be_small() -> None:
    assert style.decades(1e-9) == style.decades(0.1) == -1
