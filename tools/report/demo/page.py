"""The page: what was done, how well, on a map, in numbers, and how to look further."""

from html import escape

from trigpoint import __version__
from trigpoint.tools.report.drawing.frame import brand, html_page
from trigpoint.tools.report.drawing.svg import element

from .charts import distance_chart, latency_chart, robot_error_chart, uncertainty_chart
from .closeups import closeups
from .map import legend, magnification, map_drawing, plan_of
from .results import PAPER_DISTANCE_ERROR_M, DemoResults
from .tables import camera_table, kinds_table, message_table, missing_words
from .tiles import headline, tiles

_WIDE, _UPRIGHT = 1000.0, 420.0


def report_page(results: DemoResults, *, folder: str) -> str:
    """The whole page, self-contained: no script, no picture, no font from anywhere.

    `folder`: where the run's files are, as the reader may type it.
    """
    body = element(
        "main",
        _header(results),
        _failures(results),
        tiles(results),
        _map(results),
        _cameras(results),
        _over_time(results),
        _messages(results),
        _further(results, folder),
        _footer(results),
    )
    return html_page(f"Trigpoint demo, seed {results.seed}", body)


def _header(results: DemoResults) -> str:
    cameras = len(results.cameras)
    lead = (
        f"{cameras} cameras hang in two rooms, and no two see the same place. A robot carries a "
        "printed pattern past them. From the robot's odometry and what the cameras saw of the "
        "pattern, Trigpoint worked out live where every camera hangs and which way it looks, and "
        "told the robot where it is. The rooms are simulated, so the truth is known: this page "
        "holds the result against it."
    )
    return element(
        "header",
        brand(),
        element("h1", escape(headline(results))),
        element("p", lead, class_="lead"),
    )


def _failures(results: DemoResults) -> str:
    if not results.failures:
        return ""
    items = (element("li", escape(failure)) for failure in results.failures)
    return element("div", element("b", "What went wrong"), element("ul", *items), class_="failures")


def _map(results: DemoResults) -> str:
    wide = plan_of(results, _WIDE, upright=False)
    drawings = [
        element("div", map_drawing(results, width=_WIDE, upright=False), class_="wide"),
        element("div", map_drawing(results, width=_UPRIGHT, upright=True), class_="upright"),
    ]
    return element(
        "section",
        element("h2", "The map"),
        element(
            "figure",
            *drawings,
            legend(magnification(results, wide), suggests=_suggests(results)),
            class_="card",
        ),
    )


def _suggests(results: DemoResults) -> bool:
    return any(robot.suggestion is not None for robot in results.robots)


def _cameras(results: DemoResults) -> str:
    words = (
        "Each camera from above, up close: the ring is the truth, the point is what was found. "
        "The filled ellipse is one standard deviation, the dashed one holds 95 of 100; so the "
        "ring should mostly lie inside the dashed one. The numbers count the height too."
    )
    plan = plan_of(results, _WIDE, upright=False)
    return element(
        "section",
        element("h2", "The cameras"),
        element("p", words, class_="note"),
        closeups(results, plan),
        element("div", camera_table(results), class_="scroll"),
        element("p", missing_words(results), class_="note"),
    )


def _over_time(results: DemoResults) -> str:
    figures = []
    if results.robots and len(results.robots[0].truth.t_s):
        words = "Where the robot is said to be, beside where it is"
        figures.append(_figure(words, robot_error_chart(results)))
    if results.pairs:
        figures.append(_figure("The distances between cameras", distance_chart(results)))
    if results.series:
        figures.append(_figure("How well each camera is known", uncertainty_chart(results)))
    if len(results.latencies_s):
        words = "From light on the sensor to a correction on the bus"
        figures.append(_figure(words, latency_chart(results)))
    if not figures:
        return ""
    return element("section", element("h2", "In detail"), element("div", *figures, class_="charts"))


def _figure(title: str, chart: str) -> str:
    return element("figure", element("h3", title), chart, class_="card")


def _messages(results: DemoResults) -> str:
    return element(
        "section",
        element("h2", "The messages"),
        element("p", _messages_words(results), class_="note"),
        element("div", kinds_table(results), class_="scroll"),
        element(
            "details",
            element("summary", "Every key by itself"),
            element("div", message_table(results), class_="scroll"),
        ),
    )


def _messages_words(results: DemoResults) -> str:
    words = (
        "Every part runs in a process of its own and talks over Zenoh. What is sent on a reliable "
        "key must arrive and be recorded."
    )
    if results.restarts:
        parts = ", ".join(f"{part} ({count} ×)" for part, count in results.restarts.items())
        words += (
            f" Parts that ended and were started again: {parts}; they counted anew, so these "
            "numbers need not agree."
        )
    return escape(words)


def _further(results: DemoResults, folder: str) -> str:
    commands = (
        f"trigpoint review {folder}/session.mcap      # the drive in 3D\n"
        f"trigpoint calibrate {folder}/session.mcap   # the same estimate from the recording\n"
        f"trigpoint replay {folder}/session.mcap      # put it back on the bus"
    )
    again = f"trigpoint demo --seed {results.seed} --target {results.target} --out {folder}"
    if not results.is_whole:
        again += f" --seconds {results.seconds:g}"
    return element(
        "section",
        element("h2", "Look further"),
        element("p", "The recording and the network lie beside this page."),
        element("pre", escape(commands)),
        element("p", "The same drive again:"),
        element("pre", escape(again)),
    )


def _footer(results: DemoResults) -> str:
    words = (
        f"Trigpoint {__version__}. World «{results.world}», seed {results.seed}, target "
        f"{results.target}, {results.seconds:.0f} s. The paper's mean error of the distances "
        f"between cameras is {100 * PAPER_DISTANCE_ERROR_M:.2f} cm."
    )
    return element("footer", escape(words))
