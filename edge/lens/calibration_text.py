"""A calibration in words and as a record that JSON can hold."""

import math

from trigpoint.site.camera_info import format_camera_info

from .calibration import Calibration, Rejected
from .calibration_choice import Candidate

_GOOD_FOCAL = 0.005
THINLY_COVERED = 0.7
"""A share of the picture below which the lens is a guess in the rest of it."""


def parameter_rows(found: Calibration) -> list[tuple[str, str, str]]:
    """Each of the lens's numbers: its name, the number to two digits of its sigma, and the sigma,
    "" where nothing is known of that; with units."""
    camera = found.camera
    names = ("fx", "fy", "cx", "cy", *camera.model.coefficients)
    units = [" px"] * 4 + [""] * len(camera.model.coefficients)
    values = zip(names, units, camera.parameters, found.known.sigma, strict=True)
    return [
        (name, rounded(value, s) + unit, rounded(s, s) + unit if found.has_sigmas else "")
        for name, unit, value, s in values
    ]


def covered_share(found: Calibration) -> float:
    """The share of the picture's 81 fields that corners fell into."""
    return float((found.coverage > 0).mean())


def has_good_focal(found: Calibration) -> bool:
    """Whether the focal length is known to half a percent, and so are distances."""
    return bool(found.known.sigma[0] <= _GOOD_FOCAL * found.camera.fx)


def advice(found: Calibration) -> str:
    """What to do for a better calibration, "" where it is good."""
    if covered_share(found) < THINLY_COVERED:
        return "show the target in the parts of the picture that it was not in yet"
    if found.known.disagreement > 1.5:
        return "the views disagree: see that the target is flat and the pictures are sharp"
    if not has_good_focal(found):
        return "add pictures with the target slanted up to 45 degrees to all sides, near and far"
    return ""


def calibration_text(found: Calibration) -> str:
    """Some lines for a person: what was used, the model and why, every number with its sigma."""
    camera, known = found.camera, found.known
    coordinate_px = found.fit.rms_px / math.sqrt(2)
    lines = [
        f"{len(found.used)} views used, {found.looks} of them different, {len(found.rejected)} "
        f"rejected{_spare(found)}",
        *(f"  rejected {bad.name}: {bad.rms_px:.2f} px{_why(bad)}" for bad in found.rejected),
        f"model {camera.model.value}; error on views left out, by model: {_held_out(found)}",
        f"residuals {found.fit.rms_px:.3f} px a corner, {coordinate_px:.3f} px a coordinate; "
        f"{100 * covered_share(found):.0f} % of the picture covered; "
        f"disagreement between views {known.disagreement:.2f}",
    ]
    for name, value, sigma in parameter_rows(found):
        known_by = f" ± {sigma}" if sigma else ", how well is not known"
        lines.append(f"  {name:<3} {value}{known_by}")
    lines += [f"not determined: {doubt}" for doubt in found.doubts]
    if not found.doubts and (advised := advice(found)):
        lines.append(f"for a better one: {advised}")
    return "\n".join(lines)


def _why(bad: Rejected) -> str:
    if not bad.is_double:
        return ""
    return (
        " (the board is in two places of this picture, and the other one agrees with the rest: is "
        "this one on a monitor or in a mirror?)"
    )


def calibration_record(found: Calibration, *, name: str = "camera") -> dict[str, object]:
    """The same for programs; `intrinsics` is as in network.json, `camera_info` ROS's YAML."""
    camera, known = found.camera, found.known
    # A sigma that nothing is known of is null.
    fx, fy, cx, cy, *d = known.sigma.tolist() if found.has_sigmas else [None] * len(known.sigma)
    return {
        "intrinsics": {
            "model": camera.model.value,
            "width": camera.width,
            "height": camera.height,
            "k": camera.matrix.reshape(-1).tolist(),
            "d": list(camera.distortion),
            "sigma": {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "d": d},
        },
        "residual_px": found.fit.rms_px,
        "noise_px": known.noise_px,
        "disagreement": known.disagreement,
        "covered": covered_share(found),
        "used": [view.name for view in found.used],
        "looks": found.looks,
        "spare": found.spare,
        "rejected": [
            {"name": bad.name, "residual_px": _or_none(bad.rms_px)} for bad in found.rejected
        ],
        "held_out_px": {one.model.value: _or_none(one.held_out_px) for one in found.tried},
        "undetermined": [
            {"what": doubt.what, "why": doubt.why, "do": doubt.do} for doubt in found.doubts
        ],
        "advice": advice(found),
        "camera_info": format_camera_info(camera, name),
    }


def _spare(found: Calibration) -> str:
    return f", {found.spare} more would tell nothing new" if found.spare else ""


def _held_out(found: Calibration) -> str:
    return ", ".join(f"{one.model.value} {held_out_text(one)}" for one in found.tried)


def held_out_text(one: Candidate) -> str:
    """A model's error on views that were left out, in words."""
    if one.fit is None:
        return "fits none"
    return f"{one.held_out_px:.3f} px" if math.isfinite(one.held_out_px) else "not to be told"


def _or_none(value: float) -> float | None:
    return value if value < float("inf") else None


def rounded(value: float, sigma: float) -> str:
    """A number to two digits of its sigma."""
    if not 0 < sigma < math.inf:
        return f"{value:.6g}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(sigma)))}f}"
