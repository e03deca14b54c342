"""`python -m benchmarks page`: what the page costs, of a large site.

A process publishes 100 cameras and 30 robots at 10 Hz over Zenoh, `trigpoint board` serves them, a
socket counts what one page takes, and Chromium, where there is one, shows the page: how long after
its message a robot has moved on the screen. A bare Zenoh session that hears the same, and does
nothing with it, says what of the server's work is the bus. `--hours 24`: a browser's day of a fast
clock, too.
"""

import multiprocessing
import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated

import typer
from support.builders import TARGET_TEXT, site_text
from support.site.board_site import BoardSite, Truth
from support.site.board_site import run as publish
from support.site.visitor import Answer, Visitor

from benchmarks.network import board_browser
from benchmarks.network.board_beside import beside, opened, program
from benchmarks.table import Row, lateness_rows
from benchmarks.timing import resident_mb, worked_s
from trigpoint.contract import topics
from trigpoint.site.config import load_site
from trigpoint.zenoh import open_bus
from trigpoint.zenoh.session import called_at_once

_FILES = ("", "board.css", "board.js", "map.js", "tables.js", "looking.js", "mark.svg")
_SETTLED_S = 8.0
_GOAL_MS = 200.0
_LONGEST_S = 3600.0
_row = partial(Row, "page")
_SHOWN = (
    topics.ROBOT_POSE,
    topics.CAMERA_POSE,
    topics.COVERAGE,
    topics.SUGGESTION,
    topics.COVERAGE_GRID,
    topics.DIAGNOSTICS,
)
_ROUND_M = 10.0
"""Robot r1 goes a metre a second along x, over and over: where it is says when that was sent."""


class _Paced(Truth, frozen=True):
    def robot(self, index: int, time_s: float) -> tuple[float, float, float]:
        return (time_s % _ROUND_M, 1.0, 0.0) if index == 0 else Truth.robot(self, index, time_s)


def main(
    seconds: Annotated[float, typer.Option(help="Of each measurement.", min=2.0)] = 30.0,
    cameras: int = 100,
    robots: int = 30,
    hours: Annotated[float, typer.Option(help="Of a fast clock; 0: none.", min=0.0)] = 0.0,
) -> list[Row]:
    """Measure the page's transfer, its latency, and what its server takes."""
    with (
        tempfile.TemporaryDirectory() as folder,
        _site(Path(folder), cameras, robots) as path,
        program("board", "--site", str(path), "--port", "0", stdout=subprocess.PIPE) as server,
    ):
        assert server.stdout is not None
        address = server.stdout.readline().rpartition(" ")[2].strip()
        time.sleep(_SETTLED_S)
        rows = [
            *beside(path, address, server.pid, seconds),
            *_transfer(path, address, server.pid, seconds),
            *_to_the_page(address, seconds),
            _row("server's memory", "MB", resident_mb(server.pid), 0.0, "none"),
        ]
        if board_browser.is_there():
            rows += _to_pixels(address, seconds)
            rows += [_day(hours)] if hours else []
        return rows


@contextmanager
def _site(folder: Path, cameras: int, robots: int) -> Iterator[Path]:
    """A site file, whose site is published until the end."""
    path = folder / "site.toml"
    (folder / "target.toml").write_text(TARGET_TEXT, encoding="utf-8")
    name = f"board_bench_p{os.getpid()}"
    path.write_text(site_text(name=name, cameras=cameras, robots=robots), encoding="utf-8")
    with _beside(_publish, path, cameras, robots):
        yield path


@contextmanager
def _beside(work: Callable[..., None], *arguments: object) -> Iterator[int]:
    """Work in a process of its own inside the `with` block, at whose end its last argument is set;
    its id."""
    context = multiprocessing.get_context("spawn")
    over = context.Event()
    process = context.Process(target=work, args=(*arguments, over), daemon=True)
    process.start()
    try:
        assert process.pid is not None
        yield process.pid
    finally:
        over.set()
        process.join(20)
        process.kill()


def _publish(path: Path, cameras: int, robots: int, over: Event) -> None:
    site = load_site(path)
    with open_bus(site) as bus:
        publish(BoardSite(bus, site, _Paced(cameras, robots)), time.time, over.is_set)


def _hear_bare(path: Path, over: Event) -> None:
    """Bare Zenoh subscribers to all that the page shows."""
    site = load_site(path)
    with open_bus(site) as bus:
        session = bus._session  # what is beneath ours is measured
        hearing = [
            session.declare_subscriber(topic.expression(site.name), called_at_once(lambda _: None))
            for topic in _SHOWN
        ]
        over.wait(_LONGEST_S)
        for each in hearing:
            each.undeclare()


def _transfer(site: Path, address: str, pid: int, seconds: float) -> list[Row]:
    """On the wire, as a browser takes it; one page is open."""
    visitor = Visitor(address)
    start = sum(_size(visitor.ask(f"/{name}", Accept_Encoding="gzip")) for name in _FILES)
    with opened(address) as page:
        state = _taken(page, 0.5)
        with _beside(_hear_bare, site) as bare:
            _taken(page, _SETTLED_S)
            busy_s, begin_s = [worked_s(each) for each in (pid, bare)], time.monotonic()
            steady = _taken(page, seconds)
            for_s = time.monotonic() - begin_s
            share, floor = (
                (worked_s(each) - busy) / for_s
                for each, busy in zip((pid, bare), busy_s, strict=True)
            )
    return [
        _row("transfer at start, files", "kB", start / 1e3, 150.0, "the goal"),
        _row("transfer at start, first half second", "kB", state / 1e3, 150.0, "the goal"),
        _row("transfer, steady", "kB/s", steady / seconds / 1e3, 30.0, "the goal"),
        _row("server, one page", "cores", share, 0.1, "the goal"),
        _row("server, one page", "cores", share, floor, "bare Zenoh that hears the same"),
    ]


def _size(answer: Answer) -> int:
    return len(answer.body) + sum(len(f"{k}: {value}\n") for k, value in answer.headers.items())


def _taken(page: socket.socket, seconds: float) -> int:
    taken, end_s = 0, time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0:
        page.settimeout(left_s)
        try:
            taken += len(page.recv(1 << 16))
        except TimeoutError:
            break
    return taken


def _to_the_page(address: str, seconds: float) -> list[Row]:
    """Message to the bytes that tell a page."""
    late_ms, end_s = list[float](), time.monotonic() + seconds
    with Visitor(address).events() as messages:
        while time.monotonic() < end_s:
            robot = next(messages).get("set", {}).get("robot/r1", {})
            if "at" in robot:
                late_ms.append(1e3 * ((time.time() - robot["at"][0]) % _ROUND_M))
    return lateness_rows("page", "message to page", late_ms, _GOAL_MS)


def _to_pixels(address: str, seconds: float) -> list[Row]:
    """Message to pixels."""
    late_ms = [
        1e3 * ((painted_ms / 1e3 - at_m) % _ROUND_M)
        for at_m, painted_ms in board_browser.pixels_shown(address, seconds)
    ]
    return lateness_rows("page", "message to pixels", late_ms, _GOAL_MS)


def _day(hours: float) -> Row:
    young_mb, old_mb = board_browser.memory_mb(hours)
    what = f"memory of a browser's page after {hours:g} hours"
    return _row(what, "MB", old_mb, young_mb, "after ten minutes")
