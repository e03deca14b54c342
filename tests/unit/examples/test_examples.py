"""The examples and the blocks of docs/python.md, as a user runs them: beside a simulated drive, its
pictures, a foreign bag of it, and pictures of a board."""

import re
import runpy
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from subprocess import PIPE, Popen
from types import SimpleNamespace
from typing import Any
from uuid import UUID

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from support.builders import eventually
from support.pictures.boards import CHARUCO_TARGET, held_pictures, write_pictures

import trigpoint as tp
from trigpoint.base.clock import SystemClock
from trigpoint.contract import cdr, topics
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import PICTURE, Picture, PoseEstimate
from trigpoint.map.network import encode_tum
from trigpoint.recorder.session.recording import open_recording
from trigpoint.site.config import parse_site
from trigpoint.tools.simulation.drawing.rendering import CameraRenderer
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.world import World, load_world
from trigpoint.zenoh import open_bus

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES, PAGE = ROOT / "examples", ROOT / "docs" / "python.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that the page's blocks open, by its name there."""
    made = tmp_path_factory.mktemp("python")
    world = load_world("loop", seed=3)
    write_session(world, made / "drive")
    for file in ("site.toml", "target.toml", *(f"{name}.yaml" for name in world.cameras)):
        (made / file).write_bytes((made / "drive" / file).read_bytes())
    way = tp.open_session(made / "drive").odometry("r1")
    (made / "odometry.tum").write_bytes(encode_tum(way.stamps_ns, way.pose))
    for camera in ("c1", "c2"):
        _draw_what_shows_the_target(world, camera, made)
    first = next((made / "pictures" / "c1").iterdir())
    (made / "picture.png").write_bytes(first.read_bytes())
    _write_bag(made)
    (made / "board.toml").write_text(CHARUCO_TARGET)
    write_pictures(made / "board", held_pictures(6))
    return made


def _draw_what_shows_the_target(world: World, camera: str, folder: Path) -> None:
    made, renderer = folder / "pictures" / camera, CameraRenderer(world, camera)
    made.mkdir(parents=True)
    for index, seen in enumerate(tp.open_session(folder / "drive").sightings(camera)):
        if seen.faces:
            cv2.imwrite(str(made / f"{seen.stamp_ns}.png"), renderer.picture(index))


def _write_bag(folder: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        odometry = writer.add_connection("/odom", topics.ODOMETRY.type_name, typestore=store)
        for sample in open_recording(folder / "drive").samples([topics.ODOMETRY]):
            writer.write(odometry, sample.log_ns, sample.payload)
        front = writer.add_connection("/front/image_raw", PICTURE, typestore=store)
        for file in sorted((folder / "pictures" / "c1").iterdir()):
            stamp_ns = int(file.stem)
            message = Picture(stamp_ns, "camera", "png", file.read_bytes())
            writer.write(front, stamp_ns, cdr.encode(message))


@pytest.fixture
def example(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., list[str]]:
    """Runs an example with these arguments; its lines on standard output."""

    def run(name: str, *arguments: object) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name))
        return capsys.readouterr().out.splitlines()

    return run


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Installs an example's entry point, as its own package would."""

    def install(group: str, entry: str) -> None:
        monkeypatch.syspath_prepend(EXAMPLES)
        monkeypatch.syspath_prepend(tmp_path)
        about = tmp_path / "own-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(f"[{group}]\n{entry}\n")

    return install


def test_a_session_is_calibrated_and_held_against_its_truth(
    folder: Path, example: Callable[..., list[str]]
) -> None:
    lines = example("calibrate_session.py", folder / "drive")
    assert len(lines) == 6
    for number, line in enumerate(lines, 1):
        found = re.fullmatch(rf"c{number}: sigma (\S+) cm, error (\S+) cm", line)
        assert found is not None
        assert float(found[2]) < 5 * float(found[1])


def test_a_target_is_found_in_a_folder_of_pictures(
    folder: Path, example: Callable[..., list[str]]
) -> None:
    pictures = folder / "pictures" / "c1"
    lines = example("detect_pictures.py", pictures, folder / "target.toml")
    assert {line.partition(":")[0] for line in lines} == {str(file) for file in pictures.iterdir()}


def test_a_session_of_own_data_is_calibrated(
    folder: Path, example: Callable[..., list[str]]
) -> None:
    lines = example("own_data.py", folder)
    found = [line.partition(",")[0] for line in lines]
    assert found[:3] == ["c1: located", "c2: located", "c3: unseen"]


def test_a_source_of_pictures_of_ones_own_is_opened_by_its_scheme(
    folder: Path, plug_in: Callable[[str, str], None], capfd: pytest.CaptureFixture[str]
) -> None:
    plug_in("trigpoint.frames", "snapshot = camera_source:SnapshotFrames")
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder / "board"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        place = f"snapshot://127.0.0.1:{server.server_port}"
        camera = tp.plugins.CameraConfig(source=f"{place}/0.png", rate=100.0)
        clock, stopping = SystemClock(), threading.Event()
        source = tp.plugins.open_source(f"{place}/0.png", camera, clock=clock, directory=Path())
        frames = source.frames(stopping)
        first, second = next(frames), next(frames)
        missing = tp.plugins.open_source(f"{place}/no.png", camera, clock=clock, directory=Path())
        with pytest.raises(tp.plugins.FrameError, match="is the camera on"):
            next(missing.frames(stopping))
        stopping.set()
        assert next(frames, None) is None
        server.shutdown()
    assert isinstance(first, tp.plugins.Frame)
    assert isinstance(second, tp.plugins.Frame)
    assert first.picture.shape == (480, 640)
    assert first.captured_ns < second.captured_ns


def test_a_serial_protocol_of_ones_own_is_opened_by_its_name(
    plug_in: Callable[[str, str], None],
) -> None:
    plug_in("trigpoint.protocols", "lines = serial_protocol:Lines")
    config = tp.plugins.RobotConfig(port="loop://", protocol="lines")
    protocol = tp.plugins.make_protocol(tp.plugins.Setup("r1", config, boot=1))
    assert protocol.receive(b"1.0 2.0", 10) == []
    connected, reading, damaged = protocol.receive(b" 0.5\nnoise\n", 20)
    assert connected == tp.plugins.Connected("r1", "lines", 0)
    assert isinstance(reading, tp.plugins.Reading)
    np.testing.assert_allclose(reading.pose.translation, [1, 2, 0])
    assert isinstance(damaged, tp.plugins.Damaged)
    assert protocol.elapse(2 * 10**9) == [tp.plugins.Silent()]


def test_corrections_are_read_with_plain_zenoh_and_nothing_of_ours(
    free_port: Callable[[], int],
) -> None:
    script = EXAMPLES / "read_corrections.py"
    assert "import trigpoint" not in script.read_text()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    text = f'site = "lab"\n[bus]\nlisten = ["{endpoint}"]\n[cameras.c1]\nsource = "sim://c1"\n'
    covariance = np.diag([3e-4**2, 4e-4**2, 0, 0, 0, 1e-6])
    correction = PoseEstimate(1_500_000_000, "map", tp.Pose.planar(1, 2, 0.5), covariance)
    mark = encode_mark(CorrectionMark(UUID(int=1), 7))
    site = parse_site(text, directory=Path())
    with open_bus(site) as bus:
        publisher = bus.publisher(topics.CORRECTION, topics.CORRECTION.key("lab", "r1"))
        with Popen([sys.executable, script, "lab", endpoint], stdout=PIPE, text=True) as reader:
            try:
                assert eventually(lambda: publisher.has_listener)
                publisher.put(cdr.encode(correction), attachment=mark)
                assert reader.stdout is not None
                line = reader.stdout.readline()
            finally:
                reader.kill()
    assert line == "r1 was at (1.000, 2.000) m ± 0.05 cm, +0.500 rad, at 1.500000000 s\n"


def _blocks() -> Iterator[str]:
    return (found[1] for found in re.finditer(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL))


def test_every_block_of_the_page_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    blocks = list(_blocks())
    scripts = [block for block in blocks if "sys.argv" not in block]
    for block in scripts:
        exec(compile(block, str(PAGE), "exec"), names)
        assert block.count("\n") <= 15
    said = SimpleNamespace(**names)
    assert said.found.network.estimator == "smoother"
    assert said.network.located == [f"c{number}" for number in range(1, 7)]
    assert said.joint.shape == (12, 12)
    assert said.lens.camera.width == 640
    assert "ekf {}" in capsys.readouterr().out
    (script,) = [block for block in blocks if "sys.argv" in block]
    assert script.strip() in (EXAMPLES / "calibrate_session.py").read_text()
    assert len([line for line in script.splitlines() if line]) <= 15


def test_every_public_function_has_its_example_on_the_page() -> None:
    page = "\n".join(_blocks())
    functions = [name for name in tp.__all__ if name.islower() and not name.startswith("_")]
    assert [name for name in functions if f"tp.{name}(" not in page] == ["plugins"]
    linked = set(re.findall(r"\.\./examples/(\w+\.py)", PAGE.read_text()))
    assert linked == {file.name for file in EXAMPLES.glob("*.py")}
