"""The tables of a calibration's page."""

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from trigpoint.map.network import CameraRecord
from trigpoint.tools.report.drawing.style import PALETTE
from trigpoint.tools.report.drawing.svg import element

from .facts import CalibrationResults, view_angle_sigmas, view_angles

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
    "unusable": "sightings that are numerically unusable",
}


def overview_table(results: CalibrationResults) -> str:
    """One row a camera."""
    head = ["camera", "x m", "y m", "z m", "sigma<br>cm", "sigma<br>degrees"]
    head += ["sightings", "rejected", "rms<br>px"]
    if results.error is not None:
        head += ["error<br>cm", "error<br>degrees", "error in<br>sigmas"]
    rows = [
        _overview_row(results, name, index) for index, name in enumerate(results.network.cameras)
    ]
    return table(head, rows)


def _overview_row(results: CalibrationResults, name: str, index: int) -> str:
    camera = results.network.cameras[name]
    cells = [element("td", '<span class="disc"></span>', escape(name))]
    columns = 5
    if camera.map_from_camera is None:
        why = "; ".join((camera.status, *camera.undetermined))
        cells.append(element("td", escape(why), colspan=columns, class_="words"))
    else:
        turn = math.degrees(math.sqrt(float(np.trace(camera.covariance_matrix[3:, 3:]))))
        numbers = [_fixed(value, 3) for value in camera.map_from_camera.translation]
        numbers += [f"{100 * camera.position_sigma:.2f}", f"{turn:.2f}"]
        cells += [element("td", number) for number in numbers]
    rms = "–" if camera.reprojection_rms is None else f"{camera.reprojection_rms:.2f}"
    cells += [element("td", n) for n in (str(camera.sightings), str(camera.rejected), rms)]
    if results.error is not None:
        mine = results.error.cameras.get(name)
        shown = ["–"] * 3
        if mine is not None:
            degrees = math.degrees(mine.rotation)
            shown = [f"{100 * mine.position:.2f}", f"{degrees:.2f}", f"{mine.sigmas:.1f}"]
        cells += [element("td", number) for number in shown]
    return element("tr", *cells, class_=f"k{index % PALETTE}")


def pose_table(camera: CameraRecord) -> str:
    """Where a camera is and which way it looks, each with its standard deviation."""
    assert camera.map_from_camera is not None
    pose, covariance = camera.map_from_camera.pose, camera.covariance_matrix
    sigmas_cm = 100 * np.sqrt(np.diagonal(covariance)[:3])
    rows = [
        _value_row(axis, f"{_fixed(value, 4)} m", _deviation(sigma, "cm"))
        for axis, value, sigma in zip("xyz", pose.translation, sigmas_cm, strict=True)
    ]
    names = ("looks towards", "and down by", "picture turned by")
    angles, sigmas = view_angles(pose), view_angle_sigmas(pose, covariance)
    for name, value, sigma in zip(names, angles, sigmas, strict=True):
        rows.append(_value_row(name, f"{_fixed(value, 2)}°", _deviation(sigma, "°")))
    milliseconds, sigma_ms = 1000 * camera.time_offset, 1000 * camera.time_offset_sigma
    known = sigma_ms == 0
    rows.append(
        _value_row(
            "time offset",
            f"{milliseconds:.2f} ms",
            "taken as known" if known else f"{sigma_ms:.2f} ms",
        )
    )
    return table(("pose", "", "±"), rows)


def intrinsics_table(camera: CameraRecord) -> str:
    """The lens, each value with its standard deviation; none where it was taken as known."""
    if camera.intrinsics is None:
        return ""
    record = camera.intrinsics
    lens, sigma = record.camera, record.sigma
    values = [("fx", lens.fx, sigma.fx), ("fy", lens.fy, sigma.fy)]
    values += [("cx", lens.cx, sigma.cx), ("cy", lens.cy, sigma.cy)]
    rows = [_value_row(n, f"{v:.2f} px", _sigma(s, "{:.2f} px")) for n, v, s in values]
    for name, value, deviation in zip(
        lens.model.coefficients, lens.distortion, sigma.d, strict=True
    ):
        rows.append(_value_row(name, f"{value:.5f}", _sigma(deviation, "{:.5f}")))
    return table(("lens", escape(lens.model.value), "±"), rows)


def _fixed(value: float, digits: int) -> str:
    """Without a minus before zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def _deviation(value: float, unit: str) -> str:
    """With two digits at least where it is small."""
    number = f"{value:.2f}" if value >= 0.1 else f"{value:.3f}"
    return f"{number}{'' if unit == '°' else ' '}{unit}"


def _sigma(value: float, form: str) -> str:
    return form.format(value) if value > 0 else "taken as known"


def _value_row(name: str, value: str, sigma: str) -> str:
    return element("tr", element("td", escape(name)), element("td", value), element("td", sigma))


def guidance_table(results: CalibrationResults) -> str:
    """The next poses, in order."""
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
        rows.append(element("tr", *(element("td", cell) for cell in cells)))
    return table(head, rows)


def used_table(results: CalibrationResults) -> str:
    """What became of each camera's sightings and corners."""
    head = (
        "camera",
        "sightings<br>used",
        "contradict<br>the rest",
        "not<br>read",
        "corners<br>used",
    )
    head += ("corners beyond<br>3 sigmas",)
    rows = []
    for index, (name, found) in enumerate(results.residuals.items()):
        wild = int((~found.used).sum())
        numbers = (found.used_sightings, found.rejected, found.pending, int(found.used.sum()), wild)
        cells = [element("td", '<span class="disc"></span>', escape(name))]
        cells += [element("td", str(number)) for number in numbers]
        rows.append(element("tr", *cells, class_=f"k{index % PALETTE}"))
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
    """The distances between all cameras."""
    found = results.distances
    rows = []
    for (first, second), metres, sigma in zip(
        found.pairs, found.metres, found.sigmas_m, strict=True
    ):
        words = element("td", escape(f"{first} to {second}"))
        numbers = element("td", f"{metres:.4f}"), element("td", f"{100 * sigma:.2f}")
        rows.append(element("tr", words, *numbers))
    return table(("cameras", "metres", "sigma<br>cm"), rows)


def table(head: Sequence[str], rows: Sequence[str]) -> str:
    """A table; `head`: markup of its cells."""
    cells = element("tr", *(element("th", cell) for cell in head))
    return element("table", element("thead", cells), element("tbody", *rows))
