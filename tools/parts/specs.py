"""Which process a part is: its command, as a user would give it, and when it is stopped."""

import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from .supervisor import PartSpec

PAGE, AGENTS, BRIDGES, FIRMWARE, RECORDER, FUSION = range(6)
"""Ranks: who only looks on; the cameras' agents, since a last sighting may still make a correction;
then the bridges and the robots behind them; then the recorder, while fusion can still give it the
network; then fusion."""

_FIRMWARE_MODULE = "trigpoint.tools.simulation.serial.firmware"
# -P: a folder in the working directory that is called like a module must not be taken for it.
_PYTHON = (sys.executable, "-P", "-m")


def trigpoint(*words: str) -> tuple[str, ...]:
    """The command line of this installation's program."""
    return (*_PYTHON, "trigpoint", *words)


def agent(cameras: Sequence[str], site: str) -> PartSpec:
    """The agent of one or several cameras."""
    chosen = [word for camera in cameras for word in ("--camera", camera)]
    command = trigpoint("edge", "--site", site, *chosen)
    return PartSpec(f"edge {' '.join(cameras)}", command, AGENTS)


def bridge(robot: str, site: str) -> PartSpec:
    """The serial bridge of a robot."""
    return PartSpec(f"robot {robot}", trigpoint("robot", "--site", site, "--robot", robot), BRIDGES)


def firmware(robot: str, *, epoch_ns: int, link: Path, **options: object) -> PartSpec:
    """A simulated robot behind a pseudo-terminal, to which `link` leads; `options`: those of the
    firmware beside, like world, seed, target, log and protocol."""
    said = {"robot": robot, "epoch_ns": epoch_ns, "link": link, **options}
    words = [w for name, value in said.items() for w in (_option(name), str(value))]
    return PartSpec(f"firmware {robot}", (*_PYTHON, _FIRMWARE_MODULE, *words), FIRMWARE)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def shares(names: Sequence[str], count: int) -> list[list[str]]:
    """Names dealt out like cards, so that neighbours come into different shares."""
    return [share for i in range(count) if (share := list(names[i::count]))]


def leashed(spec: PartSpec) -> PartSpec:
    """The part, told to stop where whoever started it is killed, so that nothing is left behind
    (prctl(2), by util-linux's setpriv; where that is missing, as it is)."""
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        return spec
    return replace(spec, command=(setpriv, "--pdeathsig", "TERM", "--", *spec.command))
