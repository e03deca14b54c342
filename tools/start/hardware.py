"""What this machine has, and answers about it as the site file writes them."""

from collections.abc import Callable, Iterable
from pathlib import Path

from trigpoint.base.errors import InputError
from trigpoint.base.words import listed
from trigpoint.robot.line.protocol import PROTOCOLS as _PROTOCOLS
from trigpoint.tools.look.asked import url_of
from trigpoint.tools.target.made import Box

NONE = "none"
PROTOCOLS = tuple(_PROTOCOLS)
"""What robots speak over a port."""
_CAMERAS = ("video*",)
_PORTS = ("serial/by-id/*", "ttyUSB*", "ttyACM*")

Exists = Callable[[Path], bool]


def cameras(devices: Path = Path("/dev")) -> list[str]:
    """Video devices; of one camera usually the first gives pictures."""
    return _found(devices, _CAMERAS)


def ports(devices: Path = Path("/dev")) -> list[str]:
    """Serial ports, by a lasting name where there is one."""
    found = _found(devices, _PORTS)
    lasting = [one for one in found if "/by-id/" in one]
    return lasting or found


def camera_source(answer: str, exists: Exists = Path.exists) -> str:
    """A source of pictures from what a person writes: a device, a URL, a folder or a video."""
    if answer == NONE or "://" in answer:
        return answer
    path = Path(answer).absolute()
    if not exists(path):
        raise InputError(
            f"there is no {answer} here; write a device like /dev/video0, a URL like "
            "rtsp://camera/stream, a folder of pictures, a video, or none"
        )
    return url_of(str(path))


def robot_port(answer: str, exists: Exists = Path.exists) -> str:
    """A port: a device that is here, or a URL of pyserial's."""
    if answer == NONE or "://" in answer or exists(Path(answer)):
        return answer
    raise InputError(f"there is no {answer} here; write a device like /dev/ttyUSB0, or none")


def robot_protocol(answer: str) -> str:
    """One of the protocols that go over a port."""
    if answer not in PROTOCOLS:
        raise InputError(f"there is no protocol «{answer}»; write {listed(PROTOCOLS)}")
    return answer


def target_words(answer: str) -> str:
    """The options of `target make` from «box 0.30x0.30», «planes» or «board»."""
    kind, _, size = answer.partition(" ")
    if kind == "box" and size.strip():
        Box.parse(size.strip())
        return f"--box {size.strip()}"
    if answer in ("planes", "board"):
        return f"--{answer}"
    raise InputError(
        f"«{answer}» is no target; write box 0.30x0.40 (metres along the robot, and across it), "
        "planes or board"
    )


def _found(devices: Path, patterns: Iterable[str]) -> list[str]:
    return [str(path) for pattern in patterns for path in sorted(devices.glob(pattern))]
