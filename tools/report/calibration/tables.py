"""The tables of a calibration's page."""

import math
from collections.abc import Mapping, Sequence
from html import escape
from types import MappingProxyType

import numpy as np

from trigpoint.base.words import two_decimals
from trigpoint.map.network import CameraRecord, Network
from trigpoint.tools.networks.truth import MOST_SIGMAS, CameraError, NetworkError
from trigpoint.tools.pages.frame import fixed, row, table
from trigpoint.tools.pages.svg import camera_colour, element

from .facts import CalibrationResults, view_angle_sigmas, view_angles

_DISC = '<span class="disc"></span>'
_REASONS = {
    "wrong_size": "pictures of another size than the camera's intrinsics are for",
    "repeated": "pictures that came twice",
    "unknown_target": "faces of a target that no robot carries, or several do",
    "unknown_face": "faces that the target does not have",
    "without_odometry": "sightings for whose moment no odometry came",
    "before_odometry": "sightings from before the odometry began",
    "far_ahead": "sightings whose stamps are far ahead of the odometry",
    "unknown_sender": "messages of cameras or robots that the site file does not name",
    "stale_odometry": "odometry messages that are not newer than the one before",
    "odometry_jumps": "jumps of the odometry; the motion there is taken as unknown",
    "changed_intrinsics": "announcements of other intrinsics than those at the beginning",
    "without_intrinsics": "pictures of cameras whose intrinsics never came",
    "in_odometry_gap": "sightings while the odometry was away",
    "late": "sightings that came late",
    "clock_in_doubt": "sightings by a clock that was off, as its camera or robot said",
    "unusable": "sightings that are numerically unusable",
}


def overview_table(
    network: Network,
    error: NetworkError | None,
    more: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> str:
    """One row a camera; `error` adds columns, and `more`: head -> a cell a camera."""
    head = ["camera", "x m", "y m", "z m", "sigma<br>cm", "sigma<br>degrees"]
    head += ["sightings", "rejected", "rms<br>px"]
    if error is not None:
        head += ["error<br>cm", "error<br>degrees", "error in<br>sigmas"]
    rows = []
    for index, (name, camera) in enumerate(network.cameras.items()):
        cells = [element("td", _DISC, escape(name)), *_place_cells(camera)]
        rms = "–" if camera.reprojection_rms is None else f"{camera.reprojection_rms:.2f}"
        cells += [element("td", n) for n in (str(camera.sightings), str(camera.rejected), rms)]
        cells += [] if error is None else _error_cells(error.cameras.get(name))
        cells += [element("td", escape(column[index])) for column in more.values()]
        rows.append(element("tr", *cells, class_=camera_colour(index)))
    return table([*head, *more], rows)


def _place_cells(camera: CameraRecord) -> list[str]:
    if camera.map_from_camera is None:
        why = "; ".join((camera.status, *camera.undetermined))
        return [element("td", escape(why), colspan=5, class_="words")]
    numbers = [fixed(value, 3) for value in camera.map_from_camera.translation]
    numbers.append(two_decimals(100 * camera.position_sigma))
    numbers.append(two_decimals(math.degrees(camera.rotation_sigma)))
    return [element("td", escape(number)) for number in numbers]


def _error_cells(error: CameraError | None) -> list[str]:
    if error is None:
        return [element("td", "–")] * 3
    kind = "bad-text" if error.sigmas > MOST_SIGMAS else None
    return [
        element("td", escape(two_decimals(100 * error.position))),
        element("td", escape(two_decimals(math.degrees(error.rotation)))),
        element("td", f"{error.sigmas:.1f}", class_=kind),
    ]


def pose_table(camera: CameraRecord) -> str:
    """Where a camera is and which way it looks, each with its standard deviation."""
    assert camera.map_from_camera is not None
    pose, covariance = camera.map_from_camera.pose, camera.covariance_matrix
    sigmas_cm = 100 * np.sqrt(np.diagonal(covariance)[:3])
    rows = [
        row((axis, f"{fixed(value, 4)} m", _deviation(sigma, "cm")))
        for axis, value, sigma in zip("xyz", pose.translation, sigmas_cm, strict=True)
    ]
    names = ("looks towards", "and down by", "picture turned by")
    angles, sigmas = view_angles(pose), view_angle_sigmas(pose, covariance)
    for name, value, sigma in zip(names, angles, sigmas, strict=True):
        rows.append(row((escape(name), f"{fixed(value, 2)}°", _deviation(sigma, "°"))))
    milliseconds, sigma_ms = 1000 * camera.time_offset, 1000 * camera.time_offset_sigma
    rows.append(row(("time offset", f"{milliseconds:.2f} ms", _sigma(sigma_ms, "{:.2f} ms"))))
    return table(("pose", "", "±"), rows)


def intrinsics_table(camera: CameraRecord) -> str:
    """The lens, each value with its standard deviation; none where it was taken as known."""
    if camera.intrinsics is None:
        return ""
    record = camera.intrinsics
    lens, sigma = record.camera, record.sigma
    values = [("fx", lens.fx, sigma.fx), ("fy", lens.fy, sigma.fy)]
    values += [("cx", lens.cx, sigma.cx), ("cy", lens.cy, sigma.cy)]
    rows = [row((n, f"{v:.2f} px", _sigma(s, "{:.2f} px"))) for n, v, s in values]
    for name, value, deviation in zip(
        lens.model.coefficients, lens.distortion, sigma.d, strict=True
    ):
        rows.append(row((escape(name), f"{value:.5f}", _sigma(deviation, "{:.5f}"))))
    return table(("lens", escape(lens.model.value), "±"), rows)


def _deviation(value: float, unit: str) -> str:
    """With two digits at least where it is small."""
    number = f"{value:.2f}" if value >= 0.1 else f"{value:.3f}"
    return f"{number}{'' if unit == '°' else ' '}{unit}"


def _sigma(value: float, form: str) -> str:
    return form.format(value) if value > 0 else "taken as known"


def guidance_table(results: CalibrationResults) -> str:
    head = ("", "robot", "x m", "y m", "heading<br>degrees", "seen by", "improves")
    head += ("from<br>cm", "to<br>cm")
    rows = []
    for index, found in enumerate(results.suggestions):
        x, y, _ = found.map_from_base.translation
        heading = math.degrees(float(found.map_from_base.heading))
        cells = (
            str(index + 1), escape(found.robot), f"{x:.2f}", f"{y:.2f}", f"{heading:.0f}",
            escape(", ".join(found.seen_by)), escape(found.camera),
            f"{100 * found.sigma_m:.2f}", f"{100 * found.expected_sigma_m:.2f}",
        )  # fmt: skip
        rows.append(row(cells))
    return table(head, rows)


def used_table(results: CalibrationResults) -> str:
    """What became of each camera's sightings and corners."""
    head = (
        "camera", "sightings<br>used", "contradict<br>the rest", "not<br>read", "corners<br>used",
        "corners beyond<br>3 sigmas",
    )  # fmt: skip
    rows = []
    for index, (name, found) in enumerate(results.residuals.items()):
        wild = int((~found.used).sum())
        camera = results.network.cameras[name]
        read = camera.sightings if camera.status == "located" else 0
        pending = camera.sightings - read
        corners = int(found.used.sum())
        numbers = (read - camera.rejected, camera.rejected, pending, corners, wild)
        cells = (_DISC + escape(name), *map(str, numbers))
        rows.append(row(cells, class_=camera_colour(index)))
    return table(head, rows)


def left_out_table(results: CalibrationResults) -> str:
    """What was left out before it came to the estimator, by reason."""
    rows = [
        element(
            "tr",
            element("td", escape(_REASONS.get(reason, reason.replace("_", " "))), class_="words"),
            element("td", str(count)),
        )
        for reason, count in sorted(results.left_out.items())
    ]
    return table(("left out", "how many"), rows)


def distance_table(results: CalibrationResults) -> str:
    found = results.distances
    rows = (
        row((escape(f"{first} to {second}"), f"{metres:.4f}", f"{100 * sigma:.2f}"))
        for (first, second), metres, sigma in zip(
            found.pairs, found.metres, found.sigmas_m, strict=True
        )
    )
    return table(("cameras", "metres", "sigma<br>cm"), rows)
