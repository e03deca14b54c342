"""All nodes of a small site are brought to another version, one after the other; the map stays."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from support.builders import eventually
from support.site.forks import ForkedPrograms
from support.site.programs import answers

from trigpoint.base.clock import SteadyClock, to_ns
from trigpoint.bus.bus import Bus
from trigpoint.contract import topics
from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.correction import decode_mark
from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    Odometry,
    Sightings,
)
from trigpoint.fusion.checkpoint import Checkpoint
from trigpoint.site.config import BusConfig, load_site
from trigpoint.tools.simulation.site_files import stamps_ns, write_site
from trigpoint.tools.simulation.world import World, load_world
from trigpoint.tools.site.state import SiteStatus, summarise, table
from trigpoint.zenoh import open_bus

pytestmark = pytest.mark.timeout(400)

CAMERA, ROBOT = "c2", "r1"
BEFORE, AFTER = "0.1.0", "0.2.0"
SEEN_S = 60.0
"""From when on what this camera saw is known: it sees the robot arrive, and stand there."""
PATIENCE_S = 60.0
ORDER = ("router", "record", "edge", "robot", "fusion")


class Site:
    """A site whose fusion knows a drive; its programs, and who listens to them."""

    def __init__(self, folder: Path, port: int, stack: ExitStack) -> None:
        world = load_world("lab", seed=1)
        for name in [name for name in world.cameras if name != CAMERA]:
            del world.cameras[name]
        self.epoch_ns = time.time_ns() - to_ns(world.duration_s)
        bus = BusConfig(connect=(f"tcp/127.0.0.1:{port}",))
        self.path = write_site(world, folder, epoch_ns=self.epoch_ns, bus=bus)
        text = self.path.read_text()
        (folder / "router.toml").write_text(
            text.replace("listen = []", f'listen = ["tcp/127.0.0.1:{port}"]').replace(
                f'connect = ["tcp/127.0.0.1:{port}"]', "connect = []"
            )
        )
        _remember(world, folder / "out" / "checkpoint.bin", self.epoch_ns)
        self.folder, self.programs = folder, stack.enter_context(ForkedPrograms(folder))
        self._processes: dict[str, int] = {}

    def start(self, name: str, version: str) -> None:
        site, out = ("--site", str(self.path)), ("--out", str(self.folder / "out"))
        words = {
            "router": ("router", "--site", str(self.folder / "router.toml")),
            "record": ("record", *site, "--out", str(self.folder / "recorded")),
            "edge": ("edge", *site, "--camera", CAMERA),
            "robot": ("robot", *site, "--robot", ROBOT),
            "fusion": ("fusion", *site, *out),
        }
        self._processes[name] = self.programs.start(name, words[name], version)

    def start_firmware(self) -> None:
        words = ("firmware", "--world", "lab", "--seed", "1", "--epoch-ns", str(self.epoch_ns))
        port = str(self.folder / "r1.port")
        self.programs.start("firmware", (*words, "--robot", ROBOT, "--link", port))

    def update(self, name: str) -> None:
        assert self.programs.stop(self._processes[name]) == 0, self.programs.said(name)
        self.start(name, AFTER)


def _remember(world: World, path: Path, epoch_ns: int) -> None:
    """Write what fusion has heard of the drive's end as its checkpoint."""
    eye, log = world.cameras[CAMERA], world.odometry(ROBOT)
    size = (eye.model.width, eye.model.height)
    found: list[tuple[str, CameraInfo | Odometry | Sightings]] = []
    for number, stamp_ns in enumerate(stamps_ns(log.stamps_s, epoch_ns)):
        message = Odometry(int(stamp_ns), f"{ROBOT}/odom", f"{ROBOT}/base", log.poses[number])
        found.append((topics.ODOMETRY.key("lab", ROBOT), message))
    times_s = eye.time_of(np.arange(int(world.duration_s * eye.rate) - 1))
    for t_s, stamp_ns in zip(times_s, stamps_ns(times_s, epoch_ns), strict=True):
        faces = world.sightings(CAMERA, float(t_s)) if t_s > SEEN_S else ()
        message = Sightings(int(stamp_ns), f"{CAMERA}/optical", *size, faces)
        found.append((topics.SIGHTINGS.key("lab", CAMERA), message))
    found = [row for row in found if row[1].stamp_ns > epoch_ns + to_ns(SEEN_S)]
    found.sort(key=lambda row: row[1].stamp_ns)
    lens = CameraInfo(found[0][1].stamp_ns, f"{CAMERA}/optical", eye.model)
    checkpoint = Checkpoint(path, SteadyClock())
    for key, message in [(topics.CAMERA_INFO.key("lab", CAMERA), lens), *found]:
        checkpoint.write(key, encode(message))
    checkpoint.close()


class Listener:
    """What the site says, on the test's own bus."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._diagnostics = bus.subscribe(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key("lab"))
        self._corrections = bus.subscribe(topics.CORRECTION, topics.CORRECTION.key("lab", ROBOT))
        self._statuses: dict[str, DiagnosticStatus] = {}
        self.maps: list[UUID] = []

    def hear(self) -> None:
        while (sample := self._diagnostics.take(0.0)) is not None:
            message = decode(topics.DIAGNOSTICS.type_name, sample.payload)
            assert isinstance(message, Diagnostics)
            self._statuses |= {status.name: status for status in message.statuses}
        while (sample := self._corrections.take(0.0)) is not None:
            self.maps.append(decode_mark(sample.attachment).map_id)

    def status(self) -> SiteStatus:
        self.hear()
        tokens = self._bus.alive(topics.alive_key("lab", "*", "*"))
        return summarise("lab", peers=1, tokens=tokens, statuses=self._statuses.values())

    def is_running(self, counts: dict[str, int]) -> bool:
        """Whether so many nodes run each version, within a time."""
        expected = {version: count for version, count in counts.items() if count}

        def is_so() -> bool:
            versions = self.status().versions
            return {version: len(names) for version, names in versions.items()} == expected

        return eventually(is_so, PATIENCE_S)

    def tells(self, words: str) -> bool:
        """Whether the status as people read it has these words, within a time."""
        return eventually(lambda: words in table(self.status()), PATIENCE_S)

    def is_corrected(self) -> bool:
        """Whether a correction has come since this was asked first."""
        self.hear()
        before = len(self.maps)

        def has_come() -> bool:
            self.hear()
            return len(self.maps) > before

        return eventually(has_come, PATIENCE_S)


def test_map_stays_while_every_node_is_updated(
    tmp_path: Path, free_port: Callable[[], int], stack: ExitStack
) -> None:
    site = Site(tmp_path, free_port(), stack)
    site.start_firmware()
    for name in ORDER:
        site.start(name, BEFORE)
    bus = stack.enter_context(open_bus(load_site(site.path)))
    listener = Listener(bus)
    assert listener.is_corrected(), site.programs.said("fusion")
    before = answers(bus, "fusion/map")
    camera = _camera(bus)
    for number, name in enumerate(ORDER, 1):
        site.update(name)
        expected = {AFTER: number, BEFORE: len(ORDER) - number}
        assert listener.is_running(expected), (name, listener.status(), site.programs.said(name))
        assert listener.is_corrected(), site.programs.said(name)
        if name == "edge":
            words = f"Versions differ: {AFTER} on most, but {BEFORE}: fusion/fusion, robot/r1"
            assert listener.tells(words), table(listener.status())
    assert before is not None
    assert answers(bus, "fusion/map") == before
    assert {str(one) for one in listener.maps} == {before["map_id"]}
    np.testing.assert_allclose(_camera(bus), camera, atol=0.02)


def _camera(bus: Bus) -> list[float]:
    """Where fusion has the camera, metres."""
    network = answers(bus, "fusion/network")
    assert network is not None
    return network["cameras"][CAMERA]["map_from_camera"]["translation"]
