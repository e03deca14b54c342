"""The edge agent in a process of its own, over Zenoh."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import pytest
from support.builders import REAL_DATA, eventually
from support.commands import Cli
from support.pictures.boards import charuco, picture_of, placed, plain_picture, worst_error

from trigpoint.bus.bus import Subscription
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import CameraInfo, Sightings
from trigpoint.contract.topics import CAMERA_INFO, SIGHTINGS, alive_key, command_key
from trigpoint.geometry import CameraModel
from trigpoint.site.camera_info import format_camera_info
from trigpoint.site.config import Site, parse_site
from trigpoint.zenoh import open_bus

VIDEO = REAL_DATA / "charuco-video" / "cam_0.mp4"
BOARD = charuco()
VIEW = placed(BOARD, distance=0.8, tilt_deg=15)
LENS = CameraModel(1280, 720, 904.9, 899.9, 640.9, 367.6, (-0.37, 0.17, -0.0036, 0.0011, 0.0))


def write_site(folder: Path, port: int, camera: str, *, more: str = "", face: str = "") -> Site:
    (folder / "target.toml").write_text(
        'name = "box"\n[[faces]]\nid = 0\npattern = "charuco"\n'
        + (
            face
            or 'columns = 5\nrows = 4\nsquare = 0.06\nmarker = 0.045\ndictionary = "DICT_4X4_250"\n'
        )
        + "translation = [0.0, 0.0, 0.0]\nquaternion = [0.0, 0.0, 0.0, 1.0]\n"
    )
    text = (
        'site = "lab"\ntarget = "target.toml"\n'
        f'[bus]\n%s = ["tcp/127.0.0.1:{port}"]\n'
        f'[cameras.c1]\n{camera}\n{more}\n[robots.r1]\nport = "loop://"\n'
    )
    (folder / "site.toml").write_text(text % "connect")
    return parse_site(text % "listen", directory=folder)


@contextmanager
def agent(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "trigpoint", "edge", "--site", str(folder / "site.toml")]
    process = subprocess.Popen([*command, *words], stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def resident_megabytes(process: int) -> float:
    """What a process keeps in memory; 0 where the system does not tell."""
    status = Path(f"/proc/{process}/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return sum(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS:"))


def taken(ears: Subscription, timeout_s: float) -> Sightings | CameraInfo | None:
    sample = ears.take(timeout_s)
    if sample is None:
        return None
    message = decode(sample.encoding.partition(";")[2], sample.payload)
    assert isinstance(message, Sightings | CameraInfo)
    return message


@pytest.mark.skipif(not VIDEO.is_file(), reason="the real video charuco-video is not here")
def test_real_video_arrives_as_sightings_in_another_process(tmp_path: Path, free_port) -> None:
    (tmp_path / "c1.yaml").write_text(format_camera_info(LENS, "c1"))
    camera = f'source = "file://{VIDEO}"\nwidth = 1280\nheight = 720\nintrinsics = "c1.yaml"'
    face = 'columns = 4\nrows = 5\nsquare = 0.054\nmarker = 0.0405\ndictionary = "DICT_4X4_1000"\n'
    site = write_site(tmp_path, free_port(), camera, face=face + "inverted = true\n")
    with open_bus(site) as bus:
        ears = bus.subscribe(SIGHTINGS, SIGHTINGS.key("lab", "c1"))
        lens = bus.subscribe(CAMERA_INFO, CAMERA_INFO.key("lab", "c1"))
        with agent(tmp_path, "--camera", "c1") as process:
            stamps, corners = [], 0
            while corners < 12 and (message := taken(ears, 60.0)) is not None:
                assert isinstance(message, Sightings)
                assert (message.width, message.height) == (1280, 720)
                stamps.append(message.stamp_ns)
                corners += sum(len(face.corners) for face in message.faces)
            info = taken(lens, 60.0)
            process.send_signal(signal.SIGTERM)
            assert process.wait(60) == 0
    assert corners >= 12
    assert stamps == sorted(set(stamps))
    assert isinstance(info, CameraInfo)
    assert info.camera == LENS


def test_two_cameras_of_one_agent_play_to_their_ends(tmp_path: Path, free_port) -> None:
    for number, picture in enumerate([plain_picture(), picture_of([VIEW]), plain_picture()]):
        for name in ("one", "two"):
            (tmp_path / name).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), picture)
    more = '[cameras.c2]\nsource = "dir://two"\nrate = 1.0'
    site = write_site(tmp_path, free_port(), 'source = "dir://one"\nrate = 1.0', more=more)
    with open_bus(site) as bus:
        ears = {c: bus.subscribe(SIGHTINGS, SIGHTINGS.key("lab", c)) for c in ("c1", "c2")}
        with agent(tmp_path, "--camera", "c1", "--camera", "c2") as process:
            for camera, subscription in ears.items():
                found = [taken(subscription, 60.0) for _ in range(3)]
                counts = [len(m.faces) for m in found if isinstance(m, Sightings)]
                assert counts == [0, 1, 0], camera
                seen = found[1]
                assert isinstance(seen, Sightings)
                assert worst_error(seen.faces[0].pixels, seen.faces[0].corners, VIEW) < 0.3
            assert process.wait(60) == 0


def test_camera_whose_source_ends_is_gone_while_the_agents_other_goes_on(
    tmp_path: Path, free_port
) -> None:
    for name in ("c1", "c2"):
        (tmp_path / name).mkdir()
        for number in range(8):
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), plain_picture())
    more = f'[cameras.c2]\nsource = "dir://{tmp_path}/c2?loop=1"'
    site = write_site(
        tmp_path, free_port(), f'source = "dir://{tmp_path}/c1"\nrate = 2.0', more=more
    )
    with open_bus(site) as bus, agent(tmp_path, "--camera", "c1", "--camera", "c2") as process:
        seen = set[str]()

        def alive() -> list[str]:
            found = bus.alive(alive_key("lab", "edge", "*"))
            seen.update(found)
            return found

        first, second = alive_key("lab", "edge", "c1"), alive_key("lab", "edge", "c2")
        assert eventually(lambda: first not in alive() and seen == {first, second}, 30.0)
        assert alive() == [second]
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0


def test_snapshot_is_answered_and_sigint_ends_orderly(tmp_path: Path, free_port) -> None:
    (tmp_path / "shots").mkdir()
    cv2.imwrite(str(tmp_path / "shot.png"), picture_of([VIEW]))
    for number in range(300):  # a minute's worth
        (tmp_path / "shots" / f"{number:03d}.png").symlink_to(tmp_path / "shot.png")
    site = write_site(tmp_path, free_port(), 'source = "dir://shots"\nrate = 5.0')
    key, token = command_key("lab", "camera/c1/snapshot"), alive_key("lab", "edge", "c1")
    with open_bus(site) as bus, agent(tmp_path, "--camera", "c1") as process:
        replies = []

        def is_answered() -> bool:
            replies[:] = [reply for reply in bus.query(key, timeout_s=1.0) if not reply.error]
            return bool(replies)

        assert eventually(is_answered)
        assert replies[0].payload[:2] == b"\xff\xd8"
        assert bus.alive(token) == [token]
        assert resident_megabytes(process.pid) < 150
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert eventually(lambda: not bus.alive(token))


@pytest.mark.parametrize(
    ("camera", "name", "said"),
    [
        ('source = "file://none.mp4"', "c1", "none.mp4: there is no such video"),
        ('source = "dir://none"', "c1", "none: there is no such folder"),
        ('source = "ftp://x"', "c1", "«ftp://» are not known"),
        ('source = "dir://x"', "c9", "there is no camera «c9»"),
        (
            'source = "dir://x"\nintrinsics = "no.yaml"',
            "c1",
            "no.yaml: there is no such camera_info",
        ),
    ],
)
def test_bad_input_ends_with_one_line_and_status_2(
    tmp_path: Path, free_port, cli: Cli, camera: str, name: str, said: str
) -> None:
    write_site(tmp_path, free_port(), camera)
    site = tmp_path / "site.toml"
    # Nobody is waited for, nor met: other tests have agents of this name on this machine's bus.
    site.write_text(re.sub("connect = .*", 'listen = ["tcp/127.0.0.1:0"]', site.read_text()))
    assert said in cli("edge", "--site", site, "--camera", name, status=2).err.splitlines()[-1]
