"""The live site, drawn; and the viewer's process."""

import os
import re
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import psutil
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from support.builders import eventually

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import OperationError
from trigpoint.bus.bus import Publisher
from trigpoint.contract.topics import DIAGNOSTICS
from trigpoint.node.node import Node
from trigpoint.recorder.viewer import live as view
from trigpoint.recorder.viewer.columns import open_stream
from trigpoint.recorder.viewer.live import LiveView
from trigpoint.recorder.viewer.process import Viewer, program
from trigpoint.site.config import load_site
from trigpoint.site.target import load_target
from trigpoint.testing.memory_bus import MemoryBroker

PAUSE_S = 0.002
"""Between two messages: ten while one is the oldest that may wait."""


@contextmanager
def drawing(
    folder: Path, path: Path
) -> Iterator[tuple[Callable[[list], None], Node, "SlowStream"]]:
    """What is sent is drawn into a file, as fast as the stream may take it."""
    site = load_site(folder / "site.toml")
    stream = SlowStream(open_stream(site.name, 0))
    stream.save(path)
    broker = MemoryBroker()
    with (
        broker.session() as bus,
        broker.session() as sender,
        Node(bus, site="lab", kind="view", name="p1") as node,
    ):
        targets = {"r1": load_target(folder / "target.toml")}
        LiveView(site, targets, cast(rr.RecordingStream, stream)).start(bus, node)
        publishers: dict[str, Publisher] = {}

        def put(sent: list) -> None:
            for one in sent:
                if one.key not in publishers:
                    publishers[one.key] = sender.publisher(one.topic, one.key)
                publishers[one.key].put(one.payload)
                time.sleep(PAUSE_S)

        yield put, node, stream
        node.stop()
    stream.disconnect()


def is_over(node: Node, count: int) -> bool:
    """Whether so many messages were drawn or dropped; the node's own diagnostics are too."""
    return node.health.total("drawn") + node.health.lost("drawing") >= count


def test_a_live_site_is_drawn_like_a_recorded_one(
    site_folder: Path, story: list, tmp_path: Path
) -> None:
    sent = [one for one in story if one.topic is not DIAGNOSTICS and one.topic.name != "image"]
    with drawing(site_folder, tmp_path / "s.rrd") as (put, node, stream):
        stream.may_take.set()
        put(sent)
        assert eventually(lambda: is_over(node, len(sent)))
    found = {chunk.entity_path for chunk in RrdReader(tmp_path / "s.rrd").stream()}
    assert {"/map/cameras/c1/frustum", "/map/robots/r1/corrected", "/sigma/cameras/c1"} <= found


class SlowStream:
    """A recording stream that takes nothing in until it may."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self.may_take = threading.Event()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def flush(self, *, timeout_sec: float) -> None:
        if not self.may_take.wait(timeout_sec):
            raise RuntimeError("Flush timed out")
        self._stream.flush(timeout_sec=timeout_sec)


@pytest.mark.parametrize(("limit", "value"), [("QUEUE", 16), ("_MOST_BEHIND_NS", to_ns(0.02))])
def test_where_rerun_falls_behind_the_newest_of_each_key_is_drawn_and_it_is_said_once(
    limit: str,
    value: int,
    site_folder: Path,
    story: list,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(view, limit, value)
    sent = [one for one in story if one.topic.name in ("odom", "sightings")]
    third = len(sent) // 3
    with drawing(site_folder, tmp_path / "s.rrd") as (put, node, stream):
        put(sent[:1])  # is drawn, and rerun does not take it
        assert eventually(lambda: is_over(node, 1))
        put(sent[1:third])
        assert eventually(lambda: node.health.lost("drawing") > third - 20)
        assert float(node.health.report().values["drawing.depth"]) <= 20
        stream.may_take.set()
        assert eventually(lambda: is_over(node, third))
        stream.may_take.clear()
        lost = node.health.lost("drawing")
        put(sent[third:])
        assert eventually(lambda: node.health.lost("drawing") > lost + third)
        stream.may_take.set()
    said = [record.message for record in caplog.records if "fell behind" in record.message]
    assert len(said) == 1
    assert re.search(r"not drawn: .*\d+ odom", said[0])
    newest_ns = max(one.stamp_ns for one in sent if one.topic.name == "odom")
    assert newest_ns in times_ns(tmp_path / "s.rrd", "/map/robots/r1")


def times_ns(path: Path, entity: str) -> set[int]:
    """The moments at which something was drawn there or below."""
    found: set[int] = set()
    for chunk in RrdReader(path).stream():
        if chunk.entity_path.startswith(entity) and not chunk.is_static:
            times = chunk.to_record_batch().column("time")
            found.update(times.cast("int64").to_pylist())
    return found


def test_without_a_display_it_is_said_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(OperationError, match="--web"):
        Viewer(is_web=False)


def test_the_web_viewer_is_on_loopback_alone_and_ends() -> None:
    with Viewer(is_web=True) as viewer:
        process = psutil.Process(viewer.process_id)
        addresses = {c.laddr.ip for c in process.net_connections() if c.status == "LISTEN"}
        with urllib.request.urlopen(viewer.web_url, timeout=10) as page:
            policy = page.headers["Content-Security-Policy"]
            assert b"<html" in page.read()
    assert addresses == {"127.0.0.1"}
    assert "connect-src 'self' data: blob: http://127.0.0.1:" in policy
    assert not process.is_running()


_HOLDS_A_VIEWER = """
import sys, time
from trigpoint.recorder.viewer.process import Viewer
viewer = Viewer(is_web=True)
print(viewer.process_id, flush=True)
time.sleep(60)
"""


def test_a_killed_program_leaves_no_viewer_behind() -> None:
    command = [sys.executable, "-c", _HOLDS_A_VIEWER]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        viewer = psutil.Process(int(program.stdout.readline()))
        program.kill()
    gone = (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    assert eventually(lambda: not viewer.is_running() or viewer.status() in gone)


def test_a_page_that_rerun_does_not_have_is_not_found() -> None:
    with Viewer(is_web=True) as viewer:
        url = viewer.web_url.partition("?")[0] + "no/such/file"
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(url, timeout=10)


def test_a_viewer_that_cannot_read_its_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(OperationError, match="rerun's viewer ended at once"):
        Viewer(tmp_path / "none.rrd", is_web=True)


def test_usage_statistics_are_off() -> None:
    with Viewer(is_web=True) as viewer:
        settings = psutil.Process(viewer.process_id).environ()["XDG_CONFIG_HOME"]
        told = subprocess.run(
            [str(program()), "analytics", "config"],
            env=os.environ | {"XDG_CONFIG_HOME": settings},
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        )
    assert '"analytics_enabled": false' in told.stdout
