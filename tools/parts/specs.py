"""Which process a part is: its command, as a user would give it, and when it is stopped."""

import shutil
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from msgspec.structs import replace

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


def nodes(
    site: str, *, cameras: Sequence[str], robots: Sequence[str], agents: int, out: str = ""
) -> list[PartSpec]:
    """Recorder and fusion, which are slow to start and write to `out` if it is given; the cameras'
    agents, so many processes at most; and the robots' bridges."""
    to = ("--out", out) if out else ()
    specs = [
        PartSpec("recorder", trigpoint("record", "--site", site, *to), RECORDER),
        PartSpec("fusion", trigpoint("fusion", "--site", site, *to), FUSION),
    ]
    for share in shares(cameras, agents):
        chosen = [word for camera in share for word in ("--camera", camera)]
        command = trigpoint("edge", "--site", site, *chosen)
        specs.append(PartSpec(f"edge {' '.join(share)}", command, AGENTS))
    for robot in robots:
        command = trigpoint("robot", "--site", site, "--robot", robot)
        specs.append(PartSpec(f"robot {robot}", command, BRIDGES))
    return specs


def firmware(robot: str, *, epoch_ns: int, link: Path, **options: object) -> PartSpec:
    """A simulated robot behind a pseudo-terminal, to which `link` leads; `options`: those of the
    firmware beside, like world, seed, target, log and protocol."""
    said = {"robot": robot, "epoch_ns": epoch_ns, "link": link, **options}
    pairs = ((f"--{name.replace('_', '-')}", str(value)) for name, value in said.items())
    command = (*_PYTHON, _FIRMWARE_MODULE, *chain.from_iterable(pairs))
    return PartSpec(f"firmware {robot}", command, FIRMWARE)


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
