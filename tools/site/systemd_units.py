"""systemd units for a site's nodes: started at boot, started again, watched, and shut in.

`WatchdogSec` ends a process that has not reported progress for that long. A node reports once a
second, but only while each of its working threads gives signs of life from within its work: one for
a camera, each direction of a robot's port, each recorded topic, the disk, the estimator, and the
process that solves for it.

A node sees the file system read-only except for what it writes, only the devices that it needs, and
cannot gain privileges (`systemd-analyze security` says 3.0 at most).
"""

import getpass
import sys
from pathlib import Path

from msgspec import Struct

from trigpoint.contract.access import Kind

from .filled import filled

_UNIT = Path(__file__).with_name("node.service")
SYSUSERS = "trigpoint.conf"
SERVICE_USER = "trigpoint"
"""The user of the nodes if root writes the units: no node runs as root."""


class Unit(Struct, frozen=True):
    """One kind of node. `words`: the program's arguments; `group`: whose devices it opens, which
    are `devices` (systemd.resource-control(5)); `writes`: whether it writes files."""

    kind: Kind
    name: str
    description: str
    words: str
    group: str = ""
    devices: tuple[str, ...] = ()
    writes: bool = False


UNITS = (
    Unit(
        Kind.CAMERA,
        "trigpoint-edge@",
        "the agent of camera %i",
        "edge --camera %i",
        "video",
        ("char-video4linux", "char-media"),
    ),
    Unit(
        Kind.ROBOT,
        "trigpoint-robot@",
        "the bridge of robot %i",
        "robot --robot %i",
        "dialout",
        ("char-ttyUSB", "char-ttyACM", "char-ttyS", "char-ttyAMA"),
    ),
    Unit(Kind.FUSION, "trigpoint-fusion", "the live estimator", "fusion", writes=True),
    Unit(Kind.RECORDER, "trigpoint-recorder", "the recorder", "record", writes=True),
    Unit(Kind.ROUTER, "trigpoint-router", "the router", "router"),
)


def unit_files(folder: Path, site: Path, sessions: Path) -> dict[Path, str]:
    """Every unit's file in a folder and its text; `site`: the site file; `sessions`: the recorder's
    directory."""
    place, sessions = site.absolute(), sessions.absolute()
    files = {folder / f"{unit.name}.service": unit_text(unit, place, sessions) for unit in UNITS}
    if service_user() == SERVICE_USER:
        files[folder / SYSUSERS] = sysusers_text(site.absolute().parent)
    return files


def service_user() -> str:
    user = getpass.getuser()
    return SERVICE_USER if user == "root" else user


def sysusers_text(home: Path) -> str:
    """The service's user, by sysusers.d(5)."""
    groups = sorted({unit.group for unit in UNITS if unit.group})
    lines = [f'u {SERVICE_USER} - "Trigpoint" {_escaped(str(home))}']
    return "\n".join([*lines, *(f"m {SERVICE_USER} {group}" for group in groups), ""])


def unit_text(
    unit: Unit,
    site: Path,
    sessions: Path,
    *,
    python: str = sys.executable,
    user: str | None = None,
) -> str:
    """The text of a unit that runs this installation, or another one's `python`; `user`: who runs
    it, if not who does here."""
    command = f"{_quoted(python)} -m trigpoint {unit.words} --site {_quoted(str(site))}"
    # The dash: a missing folder does not prevent the start.
    written = dict.fromkeys([site.parent, sessions] if unit.writes else [])
    return filled(
        _UNIT,
        description=unit.description,
        command=command,
        folder=_escaped(str(site.parent)),
        user=user or service_user(),
        group=f"SupplementaryGroups={unit.group}" if unit.group else "",
        writes="\n".join(f'ReadWritePaths="-{_escaped(str(path))}"' for path in written),
        devices=_devices(unit),
    )


def _devices(unit: Unit) -> str:
    """The devices that a node sees: its own, or none but /dev/null and the like."""
    if not unit.devices:
        return "PrivateDevices=yes\nPrivateUsers=yes"
    rows = [f"DeviceAllow={device} rw" for device in unit.devices]
    return "\n".join(["DevicePolicy=closed", *rows])


def _quoted(word: str) -> str:
    """A word of a command line by systemd.syntax(7)."""
    backslashed = word.replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")
    return f'"{_escaped(backslashed)}"'


def _escaped(text: str) -> str:
    return text.replace("%", "%%")
