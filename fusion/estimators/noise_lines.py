"""Says in words what noise explains a session best where the site file and the sightings state
another."""

import math
from collections.abc import Iterable, Iterator

from trigpoint.fusion.model.dataset import DataSet

# What is smaller, or differs by less, is not worth a line.
_LEAST_TILT = math.radians(0.01)
_LEAST_SWAY_M = 5e-5
_LEAST_CHANGE = 0.05


def noise_lines(data: DataSet) -> tuple[str, ...]:
    """One line for each kind of noise that is not as stated; none where all is."""
    of_robots = ((robot, text) for robot in data.site.robots for text in _of_robot(data, robot))
    of_corners = (
        (camera, f"corners have {_factor(factor)} their stated sigma")
        for camera, factor in sorted(data.corner_scale.items())
        if _differs(factor)
    )
    robots, cameras = list(data.site.robots), list(data.site.cameras)
    return (*_named(of_robots, robots, "robots"), *_named(of_corners, cameras, "cameras"))


def _of_robot(data: DataSet, robot: str) -> Iterator[str]:
    jitter = data.jitter.get(robot)
    if jitter is not None and jitter.tilt > _LEAST_TILT:
        how = "anew in each picture"
        if jitter.length > 0:
            how = f"with a floor whose slope changes over {jitter.length:.1f} m"
        yield f"tilts by {math.degrees(jitter.tilt):.2f}° {how}"
    if jitter is not None and jitter.sway > _LEAST_SWAY_M:
        yield f"target sways by {1e3 * jitter.sway:.1f} mm"
    odometry, slip = data.odometry_scale.get(robot, (1.0, 1.0))
    if _differs(odometry):
        yield f"odometry has {_factor(odometry)} its stated noise"
    if slip > 1 and _differs(slip):
        yield f"slips {_factor(slip)} as much as assumed where it turns"


def _named(lines: Iterable[tuple[str, str]], every: list[str], kind: str) -> Iterator[str]:
    """The lines, each once, after the names that it holds for; all of `every` are their `kind`."""
    names: dict[str, list[str]] = {}
    for name, text in lines:
        names.setdefault(text, []).append(name)
    for text, mine in names.items():
        whose = f"all {kind}" if len(mine) == len(every) > 1 else ", ".join(mine)
        yield f"{whose}: {text}"


def _differs(factor: float) -> bool:
    return abs(math.log(factor)) > _LEAST_CHANGE


def _factor(factor: float) -> str:
    return f"{factor:.2g} times"
