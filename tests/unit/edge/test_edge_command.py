"""The command `edge`: several cameras in one agent, each with a life of its own."""

import threading
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest
from support.builders import TARGET_TEXT, eventually
from support.pictures.boards import plain_picture

from trigpoint.base.clock import Clock
from trigpoint.contract.topics import CAMERA_INFO, alive_key, command_key
from trigpoint.edge import command
from trigpoint.edge.sources import frames as frames_module
from trigpoint.edge.sources.frames import Frame
from trigpoint.site.config import CameraConfig, load_site
from trigpoint.testing.memory_bus import MemoryBroker, MemoryBus

_SITE = """site = "lab"
target = "t.toml"
[cameras.c1]
source = "over://"
horizontal_fov = 60.0
[cameras.c2]
source = "goes_on://"
horizontal_fov = 60.0
[robots.r1]
port = "loop://"
"""


class Sessions:
    """The sessions that the agent opens, by their camera; "" is the one of all."""

    def __init__(self) -> None:
        self.broker = MemoryBroker()
        self.closed: set[str] = set()

    def open(self, _site: object, identity: tuple[object, str] = (None, "")) -> MemoryBus:
        bus = self.broker.session()
        close = bus.close
        bus.close = lambda: (self.closed.add(identity[1]), close())[1]
        return bus


class Pictures:
    """One picture; the camera c2 then runs `meanwhile`, and ends."""

    intrinsics, skipped = None, 0
    meanwhile = Mock()

    def __init__(self, url: str, _camera: CameraConfig, *, clock: Clock) -> None:
        self._goes_on, self._clock = url.startswith("goes_on"), clock

    def frames(self, _stopping: threading.Event) -> Iterator[Frame]:
        yield Frame(plain_picture(), self._clock.now_ns())
        if self._goes_on:
            self.meanwhile()

    def close(self) -> None:
        pass


@pytest.mark.parametrize("is_secured", [False, True])
def test_camera_whose_source_is_over_leaves_nothing_on_the_bus_while_another_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_secured: bool
) -> None:
    (tmp_path / "site.toml").write_text(_SITE)
    (tmp_path / "t.toml").write_text(TARGET_TEXT)
    site, sessions, found = load_site(tmp_path / "site.toml"), Sessions(), {}
    if is_secured:
        monkeypatch.setattr(type(site.bus), "tls", Mock())

    def look() -> None:
        broker, token = sessions.broker, alive_key("lab", "edge", "c1")
        with broker.session() as desk:
            found["is over"] = eventually(lambda: not desk.alive(token))
            if is_secured:
                found["is over"] = eventually(lambda: "c1" in sessions.closed)
            for name in ("c1", "c2"):
                key = command_key("lab", f"camera/{name}/snapshot")
                found[f"answers of {name}"] = len(desk.query(key))
                kept = CAMERA_INFO.key("lab", name)
                found[f"kept of {name}"] = sum(one.key == kept for one in broker.publishers)

    monkeypatch.setattr(command, "open_bus", sessions.open)
    monkeypatch.setattr(command, "load_site", lambda _: site)
    monkeypatch.setattr(command, "stop_on_signals", lambda _: None)
    monkeypatch.setattr(frames_module, "source_class", lambda _scheme: Pictures)
    monkeypatch.setattr(Pictures, "meanwhile", lambda _: look())
    command.main(["c1", "c2"], tmp_path / "site.toml")
    assert found == {
        "is over": True,
        "answers of c1": 0,
        "kept of c1": 0,
        "answers of c2": 1,
        "kept of c2": 1,
    }
