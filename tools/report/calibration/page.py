"""The page of a calibration: where the cameras are, how well that is known, and what would help."""

from html import escape

from trigpoint import __version__
from trigpoint.base.words import counted
from trigpoint.map.network import ON_ONE_SIGHTING, CameraRecord
from trigpoint.tools.networks.building_alignment import RESIDUALS, alignment_words, residual_rows
from trigpoint.tools.pages.frame import (
    commands,
    html_page,
    note,
    row,
    scrolling,
    section,
    table,
    warning,
)
from trigpoint.tools.pages.network_map import NetworkMap, Way
from trigpoint.tools.pages.residual_charts import residual_figures
from trigpoint.tools.pages.svg import camera_colour, element

from .corrected import corrected_section
from .facts import CalibrationResults
from .tables import (
    distance_table,
    guidance_table,
    intrinsics_table,
    left_out_table,
    overview_table,
    pose_table,
    used_table,
)
from .tiles import headline, summary

_OPEN_CAMERAS = 8
_OPEN_DISTANCES = 15


def calibration_page(results: CalibrationResults) -> str:
    network = results.network
    return html_page(
        f"Trigpoint calibration of {network.site}",
        _contradicted(results),
        _undetermined(results),
        _unconfirmed(results),
        summary(results),
        _map(results),
        _building(results),
        corrected_section(results),
        _guidance(results),
        _cameras(results),
        _distances(results),
        _rejected(results),
        _further(results),
        headline=headline(results),
        lead=_lead(results),
        footer=f"Trigpoint {__version__}. Site «{network.site}», map {network.map_id}, estimator "
        f"{network.estimator}, {network.statistics.iterations} iterations.",
    )


def _lead(results: CalibrationResults) -> str:
    network = results.network
    robots = ", ".join(results.trajectories) or "no robot"
    seen = counted(results.sightings, "sighting")
    cameras = counted(len(network.cameras), "camera")
    return (
        f"{results.seconds:.0f} seconds of {robots} and {seen} by {cameras} of the site "
        f"«{network.site}», worked out together by the "
        f"{network.estimator}. Every ± and every sigma on this page is one standard deviation, by "
        "the joint covariance of all cameras, in the map: the frame in which the first robot's "
        "odometry began."
    )


def _contradicted(results: CalibrationResults) -> str:
    items = [escape(words) for words in (results.contradicted, *results.notes)]
    return warning("Why they are not to be used", items) if results.contradicted else ""


def _undetermined(results: CalibrationResults) -> str:
    items = [
        element("b", escape(name)) + escape(f": {_why(results, name)}")
        for name, camera in results.network.cameras.items()
        if camera.map_from_camera is None
    ]
    why = [] if results.network.located else map(escape, results.notes)
    return warning("What the session does not determine", [*items, *why])


def _unconfirmed(results: CalibrationResults) -> str:
    items = (
        element("b", escape(name)) + escape(f" {ON_ONE_SIGHTING}")
        for name, camera in results.network.cameras.items()
        if camera.map_from_camera is not None and not camera.confirmed
    )
    return warning("Located, and not confirmed", items)


def _why(results: CalibrationResults, name: str) -> str:
    camera = results.network.cameras[name]
    if camera.status == "unseen" and not camera.undetermined:
        return "it never saw a robot's target; drive past where it looks"
    words = "; ".join(camera.undetermined)
    residuals = results.residuals.get(name)
    if residuals is not None and len(residuals.places):
        x, y, _ = residuals.places[len(residuals.places) // 2]
        times = counted(camera.sightings, "time")
        words += f". It saw the target {times}, once with the robot near ({x:.1f}, {y:.1f}) m"
    return words


def _map(results: CalibrationResults) -> str:
    figure = NetworkMap(
        results.network.cameras,
        [
            Way(
                poses.translation[:, :2], poses.heading, "a robot's way, from the ring to the arrow"
            )
            for _, poses in results.trajectories.values()
        ],
        [suggestion.map_from_base for suggestion in results.suggestions],
        "where to go next, in this order",
        building=results.building,
    ).figure()
    return section("The map", figure) if figure else ""


def _building(results: CalibrationResults) -> str:
    title, building = "The map in the building", results.building
    if results.building_problem:
        return section(title, element("p", escape(results.building_problem)))
    if building is None:
        return ""
    words = alignment_words(building)
    if building.laying is None:
        return section(title, note(f"{words}."))
    words += (
        ", by least squares over the surveyed points. A point's residual is surveyed minus map; by "
        "chance: how often one is as large where nothing is wrong. The network in the building's "
        f"frame is in the folder {building.frame}."
    )
    rows = [row(map(escape, cells)) for cells in residual_rows(building)]
    return section(title, note(words), scrolling(table(RESIDUALS, rows), narrow=True))


def _guidance(results: CalibrationResults) -> str:
    if results.worst is None:
        return ""
    sigma_cm = 100 * results.network.cameras[results.worst].position_sigma
    open_ = [n for n, c in results.network.cameras.items() if c.status == "undetermined"]
    words = f"First drive past {', '.join(open_)} again (above). " if open_ else ""
    words += f"The camera that is known worst is {results.worst}, to {sigma_cm:.2f} cm. "
    shown = ""
    if results.suggestions:
        words += (
            "One picture more from the first of these poses is expected to lower that most; each "
            "further one is worth what it says after those before it. The robot is thought to "
            "drive there by odometry from where it ended, near ways that were driven, and to be "
            "seen where a camera has seen it before."
        )
        shown = scrolling(guidance_table(results))
    else:
        words += (
            "No single picture more, near where robots have driven, is expected to lower that by "
            "a fiftieth."
        )
    return section("What would improve it most", note(words), shown)


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
    shown = scrolling(overview_table(results.network, results.error))
    return section("The cameras", note(words), shown, *sections)


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
        class_=f"camera card {camera_colour(index)}",
        open="" if is_open else None,
    )


def _residuals(results: CalibrationResults, name: str, camera: CameraRecord) -> str:
    residuals = results.residuals.get(name)
    if residuals is None or not residuals.used.any() or camera.intrinsics is None:
        return ""
    size = camera.intrinsics.width, camera.intrinsics.height
    return residual_figures(residuals, *size, name=name)


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
    shown = scrolling(distance_table(results), narrow=True)
    if count > _OPEN_DISTANCES:
        shown = element("details", element("summary", f"All {count} distances"), shown)
    words = (
        "A tape measure can check these; <code>trigpoint distances --measured</code> holds them "
        "against its figures. What all cameras are off together does not count in them."
    )
    return section("The distances between cameras", element("p", words, class_="note"), shown)


def _rejected(results: CalibrationResults) -> str:
    words = (
        "A sighting is rejected where it contradicts what everything else says; of the others, "
        "single corners beyond three sigmas are left out. Sightings of a camera that is not "
        "located are not read."
    )
    parts = []
    if results.residuals:
        parts += [note(words), scrolling(used_table(results))]
    if results.left_out:
        parts.append(scrolling(left_out_table(results)))
    parts += [note(words) for words in results.notes]
    return section("What was used and what was not", *parts) if parts else ""


def _further(results: CalibrationResults) -> str:
    words = (
        "network.json holds everything on this page in full precision, covariance.npz the joint "
        "covariance of the located cameras, and a .tum file each robot's way."
    )
    shown = commands(
        [
            (f"trigpoint review {results.session}", "the drive in 3D"),
            (f"trigpoint distances {results.folder}", "distances with sigmas"),
            (f"trigpoint coverage {results.session}", "where robots are corrected how well"),
            (f"trigpoint calibrate {results.session}", "this page again"),
        ]
    )
    return section("Look further", element("p", words), shown)
