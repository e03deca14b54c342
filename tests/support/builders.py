"""Small things that tests need: sites, targets, messages, waiting."""

import resource
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose
from trigpoint.site.config import Site, parse_site
from trigpoint.site.target import Target, parse_target

REAL_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Real pictures and sessions; tests that need them are skipped where the folder is absent."""


def site_text(
    *, name: str = "lab", bus: str = "", cameras: int = 1, robots: int = 1, more: str = ""
) -> str:
    """A site file; `bus`: the lines of its [bus] table; `more`: further tables."""
    parts = [f'site = "{name}"\ntarget = "target.toml"']
    if bus:
        parts.append(f"[bus]\n{bus}")
    parts += [f'[cameras.c{i + 1}]\nsource = "sim://c{i + 1}"' for i in range(cameras)]
    parts += [f'[robots.r{i + 1}]\nport = "loop://"' for i in range(robots)]
    return "\n\n".join([*parts, more]) + "\n"


def make_site(
    *, name: str = "lab", bus: str = "", cameras: int = 1, robots: int = 1, more: str = ""
) -> Site:
    """The site of `site_text`, with the working folder as its directory."""
    text = site_text(name=name, bus=bus, cameras=cameras, robots=robots, more=more)
    return parse_site(text, directory=Path())


TARGET_TEXT = """\
name = "two-plane"

[[faces]]
id = 0
pattern = "checkerboard"
columns = 9
rows = 7
square = 0.0285
translation = [0.1, 0.0, 0.4]
quaternion = [0.5, -0.5, 0.5, -0.5]

[[faces]]
id = 1
pattern = "charuco"
columns = 5
rows = 7
square = 0.04
marker = 0.03
dictionary = "DICT_4X4_100"
translation = [0.0, 0.1, 0.4]
quaternion = [0.7071067811865476, 0.0, 0.0, -0.7071067811865476]
"""


def make_target() -> Target:
    """A checkerboard face and a ChArUco face."""
    return parse_target(TARGET_TEXT)


def make_odometry(
    stamp_ns: int, x: float = 0.0, y: float = 0.0, heading_rad: float = 0.0
) -> Odometry:
    """A reading of robot r1 in the plane."""
    return Odometry(stamp_ns, "r1/odom", "r1/base", Pose.planar(x, y, heading_rad))


def eventually(holds: Callable[[], bool], timeout_s: float = 60.0) -> bool:
    """Wait until `holds()`; return whether it came true in time: a machine may be very busy."""
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def told(manager: socket.socket) -> list[str]:
    """What the service manager was told since the last call."""
    messages = []
    while True:
        try:
            messages.append(manager.recv(1000).decode())
        except BlockingIOError:
            return messages


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file grows beyond so many bytes: to whoever writes, it is a disk that is full."""
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
