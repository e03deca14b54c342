"""A target as a printable PDF: one page per face at true scale, as vectors."""

from pathlib import Path

from reportlab.pdfgen.canvas import Canvas

from trigpoint.site.target import Face, Target

from .pattern import black_rectangles, described
from .sheets import BAR_MM, FOOT_MM, HEAD_MM, MARGIN_MM, Sheet, sheet_for

MILLIMETRE = 72 / 25.4
_NON_ZERO = 1  # reportlab's FILL_NON_ZERO


def draw_target(target: Target, path: Path) -> list[Sheet]:
    """Write the PDF; return the page of each face. The same target gives the same bytes."""
    canvas = Canvas(str(path), invariant=1)
    canvas.setTitle(f"Trigpoint target {target.name}")
    canvas.setAuthor("Trigpoint")
    canvas.setCreator("trigpoint target draw")
    canvas.setSubject("Print at 100 %")
    sheets = [sheet_for(face) for face in target.faces]
    for face, sheet in zip(target.faces, sheets, strict=True):
        canvas.setPageSize((sheet.width_mm * MILLIMETRE, sheet.height_mm * MILLIMETRE))
        canvas.scale(MILLIMETRE, MILLIMETRE)  # millimetres from here on
        _draw_pattern(canvas, face, sheet)
        _draw_head(canvas, face, sheet)
        _draw_foot(canvas, target, face)
        canvas.showPage()
    canvas.save()
    return sheets


def _draw_pattern(canvas: Canvas, face: Face, sheet: Sheet) -> None:
    """All rectangles as one path, so that viewers show no seams between neighbours."""
    left, top = _place(face, sheet)
    low = face.outline.min(axis=0) * 1000
    path = canvas.beginPath()
    for x, y, width, height in black_rectangles(face) * 1000:
        path.rect(left + x - low[0], top - (y - low[1]), width, -height)
    canvas.setFillGray(0.0)
    canvas.drawPath(path, stroke=0, fill=1, fillMode=_NON_ZERO)


def _place(face: Face, sheet: Sheet) -> tuple[float, float]:
    """The pattern's top left on the page, millimetres from the page's lower left."""
    width, height = ((face.outline.max(axis=0) - face.outline.min(axis=0)) * 1000)[:2]
    spare = sheet.height_mm - HEAD_MM - FOOT_MM - height
    return float(sheet.width_mm - width) / 2, float(sheet.height_mm - HEAD_MM - spare / 2)


def _draw_head(canvas: Canvas, face: Face, sheet: Sheet) -> None:
    """An arrow above the pattern that points to its top."""
    middle, tip = sheet.width_mm / 2, sheet.height_mm - 3.0
    arrow = canvas.beginPath()
    arrow.moveTo(middle, tip)
    arrow.lineTo(middle - 2, tip - 3.5)
    arrow.lineTo(middle + 2, tip - 3.5)
    arrow.close()
    canvas.drawPath(arrow, stroke=0, fill=1)
    canvas.setFont("Helvetica", 3.5)
    canvas.drawString(middle + 4, tip - 3.2, f"up, face {face.id}")


def _draw_foot(canvas: Canvas, target: Target, face: Face) -> None:
    canvas.setFont("Helvetica", 3.5)
    canvas.drawString(MARGIN_MM, 14.5, f"{target.name}, face {face.id}: {described(face)}")
    canvas.setFont("Helvetica", 2.8)
    check = "Print at 100 %, without fitting to the page. The bar must measure 100.0 mm."
    canvas.drawString(MARGIN_MM, 10.5, check)
    canvas.setLineWidth(0.2)
    canvas.line(MARGIN_MM, 6.0, MARGIN_MM + BAR_MM, 6.0)
    for tick in range(0, 101, 10):
        height = 3.0 if tick % 50 == 0 else 1.5
        canvas.line(MARGIN_MM + tick, 6.0, MARGIN_MM + tick, 6.0 + height)
