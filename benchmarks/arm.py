"""`python -m benchmarks arm`: the wheel for aarch64 under qemu's user mode: `trigpoint detect`
gives the same sightings of real pictures there as here.

qemu-user, apt and dpkg are Debian's. What that machine needs is fetched, and unpacked in `out/arm`;
nothing is installed here but there.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from trigpoint.edge.sources.picture_files import listed_pictures
from trigpoint.site.target import Target
from trigpoint.tools.shapes.text import target_text

from .pictures.real_sets import SETS, PictureSet
from .report import tell
from .table import Row

_MACHINE, _DEBIAN = "aarch64", "arm64"
_SYSTEM = ("python3", "libstdc++6")
# Of the C library that wheels are for.
_OLDEST, _NEWEST = 17, 36
_PICTURES = 5
_MOST_SECONDS = 1800
# Pictures are unpacked by other instructions there, and their pixels rounded to 1e-4.
_MOST_PX = 0.001


def main(
    data: Annotated[Path, typer.Option(help="The folder with the sets.")] = Path("../shared/data"),
    dist: Annotated[Path, typer.Option(help="The folder with the wheel.")] = Path("dist"),
    out: Annotated[Path, typer.Option(help="The other machine.")] = Path("out/arm"),
) -> None:
    """Detect boards with the wheel for aarch64, as here."""
    python = _python(out / "system")
    site = _packages(python, dist, out / "packages")
    rows = list[Row]()
    for pictured in SETS:
        pictures = listed_pictures(data / pictured.folder)[:_PICTURES] if data.is_dir() else []
        if pictures and pictured.times == 1:
            rows.append(_compared(pictured, pictures, python, site, out))
    tell(rows)
    if not rows or any(row.ours > row.other for row in rows):
        sys.exit(1)


def _compared(
    pictured: PictureSet, pictures: Sequence[Path], python: list[str], site: Path, out: Path
) -> Row:
    """How far any corner lies from where it is found here; the same must be found in both, and
    something in some picture."""
    target = out / "target.toml"
    target.write_text(target_text(Target("board", (pictured.face,))))
    words = ["-m", "trigpoint", "detect", *map(str, pictures), "--target", str(target), "--json"]
    began = time.perf_counter()
    there = _sightings([*python, "-P", *words], {"PYTHONPATH": str(site.resolve())})
    typer.echo(f"{pictured.name}: {time.perf_counter() - began:.0f} s under qemu", err=True)
    here = _sightings([sys.executable, *words], {})
    pairs = [(a["faces"], b["faces"]) for a, b in zip(there, here, strict=True)]
    found = sum(len(face["corners"]) for faces, _ in pairs for face in faces)
    off = max((_apart(*pair) for pair in pairs), default=0.0) if found else float("inf")
    what = f"{pictured.name}: {found} corners, farthest from here"
    return Row("arm", what, "px", off, _MOST_PX, "most")


def _apart(there: list[dict[str, Any]], here: list[dict[str, Any]]) -> float:
    """The farthest of any corner, pixels; infinite where others were found."""
    if [face["corners"] for face in there] != [face["corners"] for face in here]:
        return float("inf")
    pairs = zip(there, here, strict=True)
    return max(
        (float(np.abs(np.subtract(a["pixels"], b["pixels"])).max()) for a, b in pairs), default=0.0
    )


def _python(system: Path) -> list[str]:
    """The command of that machine's Python, which is fetched where it is not there."""
    emulator = shutil.which(f"qemu-{_MACHINE}")
    if emulator is None:
        sys.exit("arm: no qemu; install it (apt-get install qemu-user)")
    command = [emulator, "-L", str(system), str(system / "usr/bin/python3")]
    if not (system / "usr/bin/python3").exists():
        state = system.parent / "apt"
        for folder in ("state/lists/partial", "cache/archives/partial"):
            (state / folder).mkdir(parents=True, exist_ok=True)
        (state / "status").touch()
        options = {
            "APT::Architecture": _DEBIAN,
            "APT::Architectures": _DEBIAN,
            "APT::Install-Recommends": "0",
            "Debug::NoLocking": "1",
            "Dir::State": str((state / "state").resolve()),
            "Dir::State::status": str((state / "status").resolve()),
            "Dir::Cache": str((state / "cache").resolve()),
        }
        apt = ["apt-get", "-q", *(f"-o{key}={value}" for key, value in options.items())]
        # Sources that do not have that machine are no matter.
        subprocess.run([*apt, "update"], timeout=_MOST_SECONDS, check=False)
        _run([*apt, "-y", "--download-only", "install", *_SYSTEM])
        unpacked = state / "unpacked"
        shutil.rmtree(unpacked, ignore_errors=True)
        for package in (state / "cache/archives").glob("*.deb"):
            _run(["dpkg-deb", "-x", str(package), str(unpacked)])
        shutil.rmtree(system, ignore_errors=True)
        unpacked.rename(system)
    return command


def _packages(python: list[str], dist: Path, packages: Path) -> Path:
    """The folder with the wheel and what it depends on, fresh."""
    wheel = next(iter(sorted(dist.glob(f"*_{_MACHINE}.whl"))), None)
    if wheel is None:
        sys.exit(f"arm: no wheel for {_MACHINE} in {dist}; say make wheels")
    version = _run([*python, "-c", "import platform; print(platform.python_version())"])
    platforms = [f"--platform=manylinux_2_{n}_{_MACHINE}" for n in range(_OLDEST, _NEWEST)]
    shutil.rmtree(packages, ignore_errors=True)
    _run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"),
            *("-c", "constraints.txt", "--only-binary=:all:", "--implementation=cp"),
            *(
                f"--python-version={version.strip()}",
                *platforms,
                f"--platform=manylinux2014_{_MACHINE}",
            ),
            *(f"--target={packages}", f"{wheel}[edge]"),
        ]
    )
    return packages


def _sightings(command: list[str], beside: dict[str, str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in _run(command, beside).splitlines()]


def _run(command: list[str], beside: dict[str, str] | None = None) -> str:
    """What a command prints; ends this program where it fails."""
    ran = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | (beside or {}),
        timeout=_MOST_SECONDS,
        check=False,
    )
    if ran.returncode:
        sys.exit(f"arm: failed: {' '.join(command)}")
    return ran.stdout
