"""Says in words what noise explains a session best where the site file and the sightings state
another."""

import math
from collections.abc import Iterator

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.jitter import Jitter
from trigpoint.site.config.fusion import PriorConfig

# What is smaller, or differs by less, is not worth a line.
_LEAST_TILT = math.radians(0.05)
_LEAST_SWAY_M = 5e-5
_LEAST_CHANGE = 0.05
# A slope or a sway within rounding of its prior's was not told by pictures.
_UNTOLD = 1.1


def noise_lines(data: DataSet) -> tuple[str, ...]:
    """One line for all robots or cameras with the same noise that is not as stated; none where all
    is."""
    robots = {robot: ", ".join(_of_robot(data, robot)) for robot in data.site.robots}
    cameras = {camera: _of_camera(data, camera) for camera in data.site.cameras}
    return (*_named(robots, "robots"), *_named(cameras, "cameras"))


def _of_robot(data: DataSet, robot: str) -> Iterator[str]:
    jitter = data.jitter.get(robot)
    if jitter is not None:
        yield from _of_pictures(data.site.fusion.priors, jitter)
    odometry, slip = data.odometry_scale.get(robot, (1.0, 1.0))
    if _differs(odometry):
        yield f"{_factor(odometry)} the stated noise of odometry"
    if slip > 1 and _differs(slip):
        yield f"{_factor(slip)} the assumed slip in turns"


def _of_pictures(priors: PriorConfig, jitter: Jitter) -> Iterator[str]:
    tilts, sways = jitter.tilt > _LEAST_TILT, jitter.sway > _LEAST_SWAY_M
    may_slope = tilts and jitter.length > 0 and jitter.tilt < _UNTOLD * priors.floor_tilt
    may_sway = sways and (may_slope or not tilts) and jitter.sway < _UNTOLD * priors.target_sway
    degrees, sway = f"{math.degrees(jitter.tilt):.2f}°", f"{1e3 * jitter.sway:.1f} mm"
    untold = [f"a floor that may slope by {degrees}"] if may_slope else []
    untold += [f"a target that may sway by {sway}"] if may_sway else []
    if untold:
        yield f"{' and '.join(untold)}, as far as pictures tell"
    if tilts and not may_slope and jitter.length == 0:
        yield f"a tilt of {degrees} in each picture anew"
    elif tilts and not may_slope:
        yield f"a tilt of {degrees} by a floor whose slope changes over {jitter.length:.1f} m"
    if sways and not may_sway:
        yield f"a target that sways by {sway}"


def _of_camera(data: DataSet, camera: str) -> str:
    factor = data.corner_scale.get(camera, 1.0)
    return f"{_factor(factor)} the stated sigma of corners" if _differs(factor) else ""


def _named(texts: dict[str, str], kind: str) -> Iterator[str]:
    """Each text once, after the names that it holds for; all of them are their `kind`."""
    for text in dict.fromkeys(filter(None, texts.values())):
        names = [name for name, own in texts.items() if own == text]
        whose = f"all {kind}" if len(names) == len(texts) > 1 else ", ".join(names)
        yield f"{whose}: {text}"


def _differs(factor: float) -> bool:
    return abs(math.log(factor)) > _LEAST_CHANGE


def _factor(factor: float) -> str:
    return f"{factor:.2g} times"
