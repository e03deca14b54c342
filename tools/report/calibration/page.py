"""The page of a calibration: where the cameras are, how well that is known, and what would help."""

from html import escape

from trigpoint import __version__
from trigpoint.map.network import ON_ONE_SIGHTING, CameraRecord
from trigpoint.tools.report.drawing.frame import brand, html_page
from trigpoint.tools.report.drawing.residual_charts import histogram_drawing, picture_drawing
from trigpoint.tools.report.drawing.style import PALETTE
from trigpoint.tools.report.drawing.svg import element

from .building import building_section
from .corrected import corrected_section
from .facts import CalibrationResults
from .map import has_map, legend, magnification, map_drawing, plan_of
from .tables import (
    distance_table,
    guidance_table,
    intrinsics_table,
    left_out_table,
    overview_table,
    pose_table,
    used_table,
)
from .tiles import headline, tiles

_WIDE, _UPRIGHT = 1000.0, 420.0
_OPEN_CAMERAS = 8
_OPEN_DISTANCES = 15


def calibration_page(results: CalibrationResults) -> str:
    """The whole page, self-contained: no script, no picture, no font from anywhere."""
    body = element(
        "main",
        _header(results),
        _undetermined(results),
        _unconfirmed(results),
        tiles(results),
        _map(results),
        building_section(results),
        corrected_section(results),
        _guidance(results),
        _cameras(results),
        _distances(results),
        _rejected(results),
        _further(results),
        element("footer", escape(_footer_words(results))),
    )
    return html_page(f"Trigpoint calibration of {results.network.site}", body)


def _header(results: CalibrationResults) -> str:
    network = results.network
    robots = ", ".join(results.trajectories) or "no robot"
    seen = _counted(results.sightings, "sighting")
    cameras = _counted(len(network.cameras), "camera")
    lead = (
        f"{results.seconds:.0f} seconds of {robots} and {seen} by {cameras} of the site "
        f"«{network.site}», worked out together by the "
        f"{network.estimator}. Every ± and every sigma on this page is one standard deviation, by "
        "the joint covariance of all cameras, in the map: the frame in which the first robot's "
        "odometry began."
    )
    return element(
        "header",
        brand(),
        element("h1", escape(headline(results))),
        element("p", escape(lead), class_="lead"),
    )


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _undetermined(results: CalibrationResults) -> str:
    items = [
        element("li", element("b", escape(name)), escape(f": {_why(results, name)}"))
        for name, camera in results.network.cameras.items()
        if camera.map_from_camera is None
    ]
    if not items:
        return ""
    title = element("b", "What the session does not determine")
    return element("div", title, element("ul", *items), class_="failures")


def _unconfirmed(results: CalibrationResults) -> str:
    items = [
        element("li", element("b", escape(name)), escape(f" {ON_ONE_SIGHTING}"))
        for name, camera in results.network.cameras.items()
        if camera.map_from_camera is not None and not camera.confirmed
    ]
    if not items:
        return ""
    title = element("b", "Located, and not confirmed")
    return element("div", title, element("ul", *items), class_="failures")


def _why(results: CalibrationResults, name: str) -> str:
    camera = results.network.cameras[name]
    if camera.status == "unseen" and not camera.undetermined:
        return "it never saw a robot's target; drive past where it looks"
    words = "; ".join(camera.undetermined)
    residuals = results.residuals.get(name)
    if residuals is not None and len(residuals.places):
        x, y, _ = residuals.places[len(residuals.places) // 2]
        times = _counted(camera.sightings, "time")
        words += f". It saw the target {times}, once with the robot near ({x:.1f}, {y:.1f}) m"
    return words


def _map(results: CalibrationResults) -> str:
    if not has_map(results):
        return ""
    wide = plan_of(results, _WIDE, upright=False)
    drawings = [
        element("div", map_drawing(results, width=_WIDE, upright=False), class_="wide"),
        element("div", map_drawing(results, width=_UPRIGHT, upright=True), class_="upright"),
    ]
    key = legend(results, magnification(results, wide))
    return element(
        "section",
        element("h2", "The map"),
        element("figure", *drawings, key, class_="card"),
    )


def _guidance(results: CalibrationResults) -> str:
    if results.worst is None:
        return ""
    sigma_cm = 100 * results.network.cameras[results.worst].position_sigma
    open_ = [n for n, c in results.network.cameras.items() if c.status == "undetermined"]
    words = f"First drive past {', '.join(open_)} again (above). " if open_ else ""
    words += f"The camera that is known worst is {results.worst}, to {sigma_cm:.2f} cm. "
    parts = [element("h2", "What would improve it most")]
    if results.suggestions:
        words += (
            "One picture more from the first of these poses is expected to lower that most; each "
            "further one is worth what it says after those before it. The robot is thought to "
            "drive there by odometry from where it ended, near ways that were driven, and to be "
            "seen where a camera has seen it before."
        )
        parts += [
            element("p", escape(words), class_="note"),
            element("div", guidance_table(results), class_="scroll"),
        ]
    else:
        words += (
            "No single picture more, near where robots have driven, is expected to lower that by "
            "a fiftieth."
        )
        parts.append(element("p", escape(words), class_="note"))
    return element("section", *parts)


def _cameras(results: CalibrationResults) -> str:
    words = (
        "A camera's sigma is the root of the trace of its covariance: the size of error to expect "
        "of its place, and of its direction. A sighting is one face in one picture. A direction "
        "is given from the map's x axis towards y, and then down from the horizontal."
    )
    if results.error is not None:
        words += (
            " The truth lies beside this session, so the errors are known; the error in sigmas "
            "weighs that of the place with its full covariance."
        )
    cameras = results.network.cameras.items()
    sections = [_camera(results, name, c, index) for index, (name, c) in enumerate(cameras)]
    return element(
        "section",
        element("h2", "The cameras"),
        element("p", escape(words), class_="note"),
        element("div", overview_table(results), class_="scroll"),
        *sections,
    )


def _camera(results: CalibrationResults, name: str, camera: CameraRecord, index: int) -> str:
    if camera.map_from_camera is None:
        return ""
    tables = element("div", pose_table(camera), intrinsics_table(camera), class_="pair")
    summary = element(
        "summary", element("b", escape(name)), f" ± {100 * camera.position_sigma:.2f} cm"
    )
    is_open = len(results.network.located) <= _OPEN_CAMERAS
    return element(
        "details",
        summary,
        _residuals(results, name, camera),
        tables,
        _moved(camera),
        class_=f"camera card k{index % PALETTE}",
        open="" if is_open else None,
    )


def _residuals(results: CalibrationResults, name: str, camera: CameraRecord) -> str:
    residuals = results.residuals.get(name)
    if residuals is None or not residuals.used.any() or camera.intrinsics is None:
        return ""
    size = camera.intrinsics.width, camera.intrinsics.height
    figures = (
        picture_drawing(residuals, *size, name=name),
        histogram_drawing(residuals, name=name),
    )
    shown = [
        element("figure", picture, element("figcaption", escape(words)))
        for picture, words in figures
    ]
    return element("div", *shown, class_="pair")


def _moved(camera: CameraRecord) -> str:
    if not camera.earlier:
        return ""
    items = []
    for earlier in camera.earlier:
        x, y, z = earlier.map_from_camera.translation
        items.append(element("li", f"until {escape(earlier.until)}: ({x:.3f}, {y:.3f}, {z:.3f}) m"))
    return element("p", "It was moved in the session. Before, it was at") + element("ul", *items)


def _distances(results: CalibrationResults) -> str:
    count = len(results.distances.pairs)
    if not count:
        return ""
    shown = element("div", distance_table(results), class_="scroll narrow")
    if count > _OPEN_DISTANCES:
        shown = element("details", element("summary", f"All {count} distances"), shown)
    words = (
        "A tape measure can check these; `trigpoint distances --measured` holds them against its "
        "figures. What all cameras are off together does not count in them."
    )
    return element(
        "section",
        element("h2", "The distances between cameras"),
        element(
            "p", escape(words).replace("`trigpoint distances --measured`", _CODE), class_="note"
        ),
        shown,
    )


_CODE = "<code>trigpoint distances --measured</code>"


def _rejected(results: CalibrationResults) -> str:
    words = (
        "A sighting is rejected where it contradicts what everything else says; of the others, "
        "single corners beyond three sigmas are left out. Sightings of a camera that is not "
        "located are not read."
    )
    parts = [element("h2", "What was used and what was not")]
    if results.residuals:
        parts += [
            element("p", words, class_="note"),
            element("div", used_table(results), class_="scroll"),
        ]
    if results.left_out:
        parts.append(element("div", left_out_table(results), class_="scroll"))
    parts += [element("p", escape(note), class_="note") for note in results.notes]
    return element("section", *parts) if len(parts) > 1 else ""


def _further(results: CalibrationResults) -> str:
    commands = [
        (f"trigpoint review {results.session}", "the drive in 3D"),
        (f"trigpoint distances {results.folder}", "distances with sigmas"),
        (f"trigpoint coverage {results.session}", "where robots are corrected how well"),
        (f"trigpoint calibrate {results.session}", "this page again"),
    ]
    width = max(len(command) for command, _ in commands)
    lines = "\n".join(f"{command:<{width}}  # {what}" for command, what in commands)
    words = (
        "network.json holds everything on this page in full precision, covariance.npz the joint "
        "covariance of the located cameras, and a .tum file each robot's way."
    )
    return element(
        "section",
        element("h2", "Look further"),
        element("p", words),
        element("pre", escape(lines)),
    )


def _footer_words(results: CalibrationResults) -> str:
    network = results.network
    iterations = network.statistics.iterations
    return (
        f"Trigpoint {__version__}. Site «{network.site}», map {network.map_id}, estimator "
        f"{network.estimator}, {iterations} iterations."
    )
