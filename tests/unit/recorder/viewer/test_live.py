"""The live site, drawn; and the viewer's process."""

import os
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import psutil
import pytest
from rerun.chunk import RrdReader
from support.builders import eventually

from trigpoint.base.errors import OperationError
from trigpoint.contract.topics import DIAGNOSTICS
from trigpoint.node.node import Node
from trigpoint.recorder.viewer import live as view
from trigpoint.recorder.viewer.columns import open_stream
from trigpoint.recorder.viewer.live import LiveView
from trigpoint.recorder.viewer.process import Viewer, program
from trigpoint.site.config import load_site
from trigpoint.site.target import load_target
from trigpoint.testing.memory_bus import MemoryBroker


def show(folder: Path, sent: list, path: Path) -> Node:
    """Draw what is sent into a file; return the node, stopped."""
    site = load_site(folder / "site.toml")
    stream = open_stream(site.name, 0)
    stream.save(path)
    broker = MemoryBroker()
    with (
        broker.session() as bus,
        broker.session() as sender,
        Node(bus, site="lab", kind="view", name="p1") as node,
    ):
        LiveView(site, {"r1": load_target(folder / "target.toml")}, stream).start(bus, node)
        publishers = {one.key: sender.publisher(one.topic, one.key) for one in sent}
        for one in sent:
            publishers[one.key].put(one.payload)
        lost = node.health
        assert eventually(
            lambda: lost.total("drawn") + lost.lost("drawing") >= len(sent), timeout_s=20
        )
        node.stop()
    stream.disconnect()
    return node


def test_a_live_site_is_drawn_like_a_recorded_one(
    site_folder: Path, story: list, tmp_path: Path
) -> None:
    sent = [one for one in story if one.topic is not DIAGNOSTICS and one.topic.name != "image"]
    show(site_folder, sent, tmp_path / "s.rrd")
    found = {chunk.entity_path for chunk in RrdReader(tmp_path / "s.rrd").stream()}
    assert {"/map/cameras/c1/frustum", "/map/robots/r1/corrected", "/sigma/cameras/c1"} <= found


def test_slow_drawing_drops_the_oldest_and_counts(
    site_folder: Path, story: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, "QUEUE", 3)
    sent = [one for one in story if one.topic.name == "odom"]
    node = show(site_folder, sent, tmp_path / "s.rrd")
    assert node.health.lost("drawing") > 0


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
    assert eventually(lambda: not viewer.is_running() or viewer.status() in gone, timeout_s=20)


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
