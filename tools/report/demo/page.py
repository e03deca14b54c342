"""The page: what was done, how well, on a map, in numbers, and how to look further."""

from html import escape

from trigpoint import __version__
from trigpoint.tools.networks.truth import MOST_SIGMAS
from trigpoint.tools.pages.frame import (
    commands,
    html_page,
    note,
    scrolling,
    section,
    table,
    warning,
)
from trigpoint.tools.pages.network_map import WIDE, NetworkMap, Way
from trigpoint.tools.pages.svg import element
from trigpoint.tools.report.calibration.tables import overview_table

from .charts import distance_chart, latency_chart, robot_error_chart, uncertainty_chart
from .closeups import closeups
from .results import PAPER_DISTANCE_ERROR_M, Arrival, DemoResults, KindCount, Track
from .tiles import headline, summary

_ARRIVALS = {
    Arrival.COMPLETE: ("complete", None),
    Arrival.BROKEN: ("not complete", "bad-text"),
    Arrival.UNKNOWN: ("a part began anew", "quiet"),
    Arrival.BEST_EFFORT: ("best effort", "quiet"),
}
"""The words for it and their style."""


def report_page(results: DemoResults, *, folder: str) -> str:
    """The whole page; `folder`: where the run's files are, as the reader may type it."""
    drawn = network_map(results)
    return html_page(
        f"Trigpoint demo, seed {results.seed}",
        warning("What went wrong", map(escape, results.failures)),
        summary(results),
        section("The map", drawn.figure()),
        _cameras(results, drawn),
        _over_time(results),
        _messages(results),
        _further(results, folder),
        headline=headline(results),
        lead=_lead(results),
        footer=f"Trigpoint {__version__}. World «{results.world}», seed {results.seed}, target "
        f"{results.target}, {results.seconds:.0f} s. The paper's mean error of the distances "
        f"between cameras is {100 * PAPER_DISTANCE_ERROR_M:.2f} cm.",
    )


def _lead(results: DemoResults) -> str:
    return (
        f"{len(results.cameras)} cameras hang in two rooms, and no two see the same place. A robot "
        "carries a printed pattern past them. From the robot's odometry and what the cameras saw "
        "of the pattern, Trigpoint worked out live where every camera hangs and which way it "
        "looks, and told the robot where it is. The rooms are simulated, so the truth is known: "
        "this page holds the result against it."
    )


def network_map(results: DemoResults) -> NetworkMap:
    """What is on the map: the network as it was found and as it truly is."""
    ways = []
    for robot in results.robots:
        ways += [
            _way(robot.truth, "true", "the robot's true way, from the ring to the arrow"),
            _way(robot.odometry, "reckoned", "its way by odometry alone"),
            _way(robot.live, "corrected", "its way as Trigpoint said it live"),
        ]
    return NetworkMap(
        {camera.name: camera.record for camera in results.cameras},
        ways,
        [robot.suggestion for robot in results.robots if robot.suggestion is not None],
        "where it was last told to go next, to improve the worst camera most",
        truth={camera.name: camera.truth for camera in results.cameras},
        walls=results.walls,
    )


def _way(track: Track, kind: str, words: str) -> Way:
    return Way(track.places, track.headings, words, kind, is_best=kind == "true")


def _cameras(results: DemoResults, drawn: NetworkMap) -> str:
    words = (
        "Each camera from above, up close: the ring is the truth, the point is what was found. "
        "The filled ellipse is one standard deviation, the dashed one holds 95 of 100; so the "
        "ring should mostly lie inside the dashed one. The numbers count the height too."
    )
    skipped = ["–" if c.skipped is None else str(c.skipped) for c in results.cameras]
    overview = overview_table(results.network, results.error, {"pictures<br>missed": skipped})
    plan = drawn.plan(WIDE, upright=False)
    return section(
        "The cameras", note(words), closeups(results, plan), scrolling(overview),
        note(_camera_words(results)),
    )  # fmt: skip


def _camera_words(results: DemoResults) -> str:
    """What the columns mean, and why a camera may have no numbers."""
    words = (
        "Sigma is the root of the trace of the camera's covariance. «Error in sigmas» weighs the "
        f"place's error with the full covariance (Mahalanobis); more than {MOST_SIGMAS:.0f} would "
        "be a failure. «Pictures missed» were made but not looked at, since the machine was busy."
    )
    unvisited = [camera.name for camera in results.cameras if not camera.came_by]
    if unvisited:
        words += f" The robot did not come by {', '.join(unvisited)} in this time."
    if results.overload:
        words += f" {results.overload.capitalize()}."
    return words


def _over_time(results: DemoResults) -> str:
    figures = []
    if results.robots and len(results.robots[0].truth.t_s):
        words = "Where the robot is said to be, beside where it is"
        figures.append(_figure(words, robot_error_chart(results)))
    if results.distances.pairs:
        figures.append(_figure("The distances between cameras", distance_chart(results)))
    if results.series:
        figures.append(_figure("How well each camera is known", uncertainty_chart(results)))
    if len(results.latencies_s):
        words = "From light on the sensor to a correction on the bus"
        figures.append(_figure(words, latency_chart(results)))
    if not figures:
        return ""
    return section("In detail", element("div", *figures, class_="charts"))


def _figure(title: str, chart: str) -> str:
    return element("figure", element("h3", title), chart, class_="card")


def _messages(results: DemoResults) -> str:
    every = element("details", element("summary", "Every key by itself"),
                    scrolling(_message_table(results)))  # fmt: skip
    return section(
        "The messages", note(_messages_words(results)), scrolling(_kinds_table(results)), every
    )


def _kinds_table(results: DemoResults) -> str:
    """One row a kind of key, the messages of its keys added up."""
    rows = [_counts_row(kind, str(kind.keys)) for kind in results.kinds]
    return table(("key", "keys", "sent", "received", "recorded", ""), rows)


def _message_table(results: DemoResults) -> str:
    """One row a key, with who received it."""
    rows = [
        _counts_row(results.counted(count.path, [count]), ", ".join(count.received) or "–")
        for count in results.keys
    ]
    return table(("key", "received by", "sent", "received", "recorded", ""), rows)


def _counts_row(count: KindCount, second: str) -> str:
    cells = (element("code", escape(count.path)), escape(second), *count.numbers)
    words, kind = _ARRIVALS[count.arrival]
    shown = (element("td", cell) for cell in cells)
    return element("tr", *shown, element("td", words, class_=kind))


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
    return words


def _further(results: DemoResults, folder: str) -> str:
    session = f"{folder}/session.mcap"
    again = f"trigpoint demo --seed {results.seed} --target {results.target} --out {folder}"
    if not results.is_whole:
        again += f" --seconds {results.seconds:g}"
    return section(
        "Look further",
        element("p", "The recording and the network lie beside this page."),
        commands(
            [
                (f"trigpoint review {session}", "the drive in 3D"),
                (f"trigpoint calibrate {session}", "the same estimate from the recording"),
                (f"trigpoint replay {session}", "put it back on the bus"),
            ]
        ),
        element("p", "The same drive again:"),
        element("pre", escape(again)),
    )
