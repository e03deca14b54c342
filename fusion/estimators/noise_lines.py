"""Says in words what noise a session showed that the site file and the sightings do not state."""

import math

from trigpoint.fusion.model.dataset import DataSet

# What is smaller, or differs by less, is not worth a line.
_LEAST_TILT = math.radians(0.01)
_LEAST_SWAY_M = 5e-5
_LEAST_CHANGE = 0.1


def noise_lines(data: DataSet) -> tuple[str, ...]:
    """One line for each kind of noise that was learnt; none where all is as stated."""
    lines = []
    for robot in data.site.robots:
        jitter = data.jitter.get(robot)
        if jitter is not None and jitter.tilt > _LEAST_TILT:
            how = "anew in each picture"
            if jitter.length > 0:
                how = f"with a floor whose slope changes over {jitter.length:.1f} m"
            lines.append(f"{robot} tilts by {math.degrees(jitter.tilt):.2f}° {how}")
        if jitter is not None and jitter.sway > _LEAST_SWAY_M:
            lines.append(f"the target of {robot} sways by {1e3 * jitter.sway:.1f} mm")
        odometry, slip = data.odometry_scale.get(robot, (1.0, 1.0))
        if _differs(odometry):
            lines.append(f"the odometry of {robot} has {_factor(odometry)} its stated noise")
        if slip > 1 and _differs(slip):
            lines.append(f"{robot} slips {_factor(slip)} as much as assumed where it turns")
    by_factor: dict[str, list[str]] = {}
    for camera, factor in sorted(data.corner_scale.items()):
        if _differs(factor):
            by_factor.setdefault(_factor(factor), []).append(camera)
    for factor, cameras in by_factor.items():
        whose = "all cameras" if len(cameras) == len(data.site.cameras) else ", ".join(cameras)
        lines.append(f"the corners of {whose} have {factor} their stated sigma")
    return tuple(lines)


def _differs(factor: float) -> bool:
    return abs(math.log(factor)) > _LEAST_CHANGE / 2


def _factor(factor: float) -> str:
    return f"{factor:.2g} times"
