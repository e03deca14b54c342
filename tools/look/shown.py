"""What `look` says of a moment: as a record for the page, as lines for the terminal."""

from collections.abc import Sequence

from msgspec import Struct

from trigpoint.base.words import counted
from trigpoint.edge.lens.calibration import Calibration
from trigpoint.edge.lens.calibration_text import covered_share, parameter_rows

from .guidance import Need
from .seen import Seen


class Face(Struct, frozen=True):
    """`pixels`: columns and rows of the corners in turn, by tenths."""

    name: str
    pixels: list[float]


class Lens(Struct, frozen=True):
    """A lens that was worked out. `rows`: its numbers' names, and the numbers with their sigmas;
    `open`: what the views do not determine."""

    summary: str
    rows: list[tuple[str, str]]
    open: list[str]


class Shown(Struct, frozen=True):
    """A moment. `stamp`: names the picture; `facts`: what and how much, in words; `hints`: what the
    target file has wrong, and at the end what was left out; `next`: the need that `advice` is
    about; `coverage`: corners of the kept views by field, row by row; `trouble`: why the views lead
    to no lens yet; `over`: how it ended, "" while it runs."""

    number: int
    stamp: str
    width: int
    height: int
    faces: list[Face]
    facts: list[tuple[str, str]]
    hints: list[str]
    advice: str
    next: str
    needs: tuple[Need, ...]
    coverage: list[int]
    views: int
    is_working: bool
    lens: Lens | None
    trouble: str
    written: str
    over: str = ""

    @property
    def line(self) -> str:
        facts = "; ".join(f"{what} {value}" for what, value in self.facts)
        return f"picture {self.number}: {facts}"


def faces_of(seen: Sequence[Seen]) -> list[Face]:
    """What is drawn into the picture."""
    return [
        Face(one.name, [round(float(value), 1) for value in one.sighting.pixels.reshape(-1)])
        for one in seen
    ]


def facts_of(seen: Sequence[Seen]) -> list[tuple[str, str]]:
    """What a picture shows of the target."""
    if not seen:
        return [("corners", "none")]
    first, total = seen[0], sum(one.corners for one in seen)
    where = f"on {first.name}" if len(seen) == 1 else f"on {counted(len(seen), 'face')}"
    facts = [
        ("corners", f"{total} {where}"),
        ("a square", f"{first.square_px:.0f} px"),
        ("edges", first.sharpness),
        ("sigma", f"{first.sigma_px:.2f} px a coordinate"),
    ]
    if first.speed_px >= 1:
        facts.append(("moves", f"{first.speed_px:.0f} px a second"))
    return facts


def lens_of(found: Calibration) -> Lens:
    rows = [
        (name, f"{value} ± {sigma}" if sigma else value)
        for name, value, sigma in parameter_rows(found)
    ]
    model, views = found.camera.model.value, counted(len(found.used), "view")
    summary = (
        f"{model} of {views}: RMS {found.fit.rms_px:.2f} px a corner, "
        f"{100 * covered_share(found):.0f} % of the picture covered"
    )
    return Lens(summary, rows, [str(doubt) for doubt in found.doubts])
