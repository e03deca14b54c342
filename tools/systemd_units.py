"""systemd units for a site's nodes: started at boot, started again, and watched.

`WatchdogSec` ends a process that has not said for so long that its work goes on. A node says so
once a second, but only while each of its working threads has given a sign of life from within its
work: one for a camera, for each direction of a robot's port, for each topic that is recorded, for
the disk, for the estimator and for the process that solves for it.
"""

import getpass
import sys
from dataclasses import dataclass
from pathlib import Path

WATCHDOG_S = 30


@dataclass(frozen=True, slots=True)
class Unit:
    """One kind of node. `words`: the program's arguments; `group`: whose devices it opens."""

    name: str
    description: str
    words: str
    group: str = ""


UNITS = (
    Unit("trigpoint-edge@", "the agent of camera %i", "edge --camera %i", "video"),
    Unit("trigpoint-robot@", "the bridge of robot %i", "robot --robot %i", "dialout"),
    Unit("trigpoint-fusion", "the live estimator", "fusion"),
    Unit("trigpoint-recorder", "the recorder", "record"),
)


def unit_files(folder: Path, site: Path) -> dict[Path, str]:
    """Every unit's file in a folder and its text; `site`: the site file."""
    return {folder / f"{unit.name}.service": unit_text(unit, site.absolute()) for unit in UNITS}


def unit_text(unit: Unit, site: Path) -> str:
    """The text of a unit that runs this very installation as this user."""
    command = f"{_quoted(sys.executable)} -m trigpoint {unit.words} --site {_quoted(str(site))}"
    group = f"SupplementaryGroups={unit.group}\n" if unit.group else ""
    return f"""\
[Unit]
Description=Trigpoint: {unit.description}
Wants=network-online.target
After=network-online.target time-sync.target
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={command}
WorkingDirectory={_escaped(str(site.parent))}
User={getpass.getuser()}
{group}Restart=always
RestartSec=2
# What is wrong with a file is not mended by starting again.
RestartPreventExitStatus=2
WatchdogSec={WATCHDOG_S}
# A node waits for the bus as long as it takes.
TimeoutStartSec=infinity
TimeoutStopSec=20
NoNewPrivileges=yes
PrivateTmp=yes
ProtectSystem=full

[Install]
WantedBy=multi-user.target
"""


def _quoted(word: str) -> str:
    """A word of a command line by systemd.syntax(7)."""
    backslashed = word.replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")
    return f'"{_escaped(backslashed)}"'


def _escaped(text: str) -> str:
    return text.replace("%", "%%")
