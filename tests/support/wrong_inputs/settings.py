"""Site files and lens files that are not what the program reads."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from support.lens_dialects import of_kalibr, of_matlab, of_opencv

from trigpoint.geometry import CameraModel
from trigpoint.site.camera_info import read_camera_info, write_camera_info

from .case import LOCATED, Case, Kind
from .odometry import calibrated

_SITE: str = """\
site = "lab"
target = "target.toml"
[cameras.c1]
source = "dir:///x"
width = 640
rate = 5.0
horizontal_fov = 60.0
[robots.r1]
port = "loop://"
baud = 57600
max_speed = 2.0
[robots.r1.odometry]
distance = 0.006
heading_turn = 0.006
[fusion]
late = 1.0
"""


def _printed(lens: CameraModel) -> str:
    """What people copy from a terminal."""
    return f"mtx =\n{lens.matrix}\ndist =\n{np.array(lens.distortion)}\n"


# With as many coefficients as these programs write unless told otherwise.
_DIALECTS = (of_opencv, partial(of_kalibr, coefficients=4), partial(of_matlab, radial=2))


def foreign_lens(folder: Path, random: np.random.Generator) -> Case:
    """Read where it says the same."""
    words = calibrated(folder)
    path = folder / "c1.yaml"
    dialect = _DIALECTS[random.integers(len(_DIALECTS))]
    path.write_text(dialect(read_camera_info(path), str), encoding="utf-8")
    return Case(words, (0,), (LOCATED,))


def unreadable_lens(folder: Path, _random: np.random.Generator) -> Case:
    words = calibrated(folder)
    path = folder / "c1.yaml"
    path.write_text(_printed(read_camera_info(path)), encoding="utf-8")
    return Case(words, (2,), (r"c1\.yaml", r"camera_info|camera_matrix"))


def impossible_lens(folder: Path, random: np.random.Generator) -> Case:
    """A focal length, a centre or a distortion that no lens has."""
    words = calibrated(folder)
    path = folder / "c1.yaml"
    lens = read_camera_info(path)
    write_camera_info(path, lens, "c1")
    was, now = [
        (lens.fx, 0.0),
        (lens.fx, -lens.fx),
        (lens.cx, 20 * lens.cx),
        (lens.fy, 1000 * lens.fy),
        (lens.distortion[0], -5.0),
        (lens.distortion[0], float("nan")),
    ][random.integers(6)]
    path.write_text(path.read_text(encoding="utf-8").replace(repr(was), repr(now), 1), "utf-8")
    return Case(words, (2,), (r"c1\.yaml",))


def unknown_key(folder: Path, random: np.random.Generator) -> Case:
    """A key with a letter too few: line, key and what is near are named."""
    lines: list[str] = _SITE.splitlines()
    places = [at for at, line in enumerate(lines) if " = " in line]
    at = int(random.choice(places[2:]))
    key = lines[at].split()[0]
    k = int(random.integers(1, len(key)))
    wrong = key[:k] + key[k + 1 :]
    lines[at] = lines[at].replace(key, wrong, 1)
    says = (rf"site\.toml:{at + 1}\b", rf"\b{wrong}\b", rf"\b{key}\b")
    return Case(_looked_at(folder, lines), (2,), says)


def missing_robot(folder: Path, random: np.random.Generator) -> Case:
    """The robot that is asked for is not in the file, or none is."""
    lines: list[str] = _SITE.splitlines()
    if random.integers(2):
        begin = lines.index("[robots.r1]")
        return Case(_looked_at(folder, lines[:begin]), (2,), (r"\brobots\b|no robot",))
    other = str(random.choice(["rover", "r10", "robot1"]))
    lines = [line.replace("robots.r1", f"robots.{other}") for line in lines]
    return Case(_looked_at(folder, lines), (2,), ("r1", other))


def _looked_at(folder: Path, lines: list[str]) -> tuple[str | Path, ...]:
    site = folder / "site.toml"
    site.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return ("robot", "--site", site, "--robot", "r1", "--dry-run")


SETTINGS: Mapping[str, Kind] = {
    "a foreign lens file": foreign_lens,
    "no lens file at all": unreadable_lens,
    "a lens that cannot be": impossible_lens,
    "an unknown key": unknown_key,
    "a robot that is missing": missing_robot,
}
