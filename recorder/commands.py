"""The commands `record`, `view`, `review` and `replay`."""

import os
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from trigpoint.base.clock import SystemClock, to_seconds
from trigpoint.base.errors import InputError, OperationError
from trigpoint.base.words import counted
from trigpoint.contract.access import Kind
from trigpoint.contract.topics import command_key
from trigpoint.metrics.serving import metrics_served
from trigpoint.node.node import Node, stopped_by_signals
from trigpoint.site.config import Site, load_site, parse_site
from trigpoint.site.option import SITE_FILE, MetricsAt, SiteFile
from trigpoint.site.target import load_target
from trigpoint.zenoh import open_bus

from . import node as recorder
from .replay import player
from .replay.pace import Controls, keyboard, span_of
from .session.recording import Recording, open_recording
from .viewer.page import LOOPBACK
from .viewer.process import WEB_PORT, Viewer
from .writing.sink import McapSink

if TYPE_CHECKING:
    import rerun as rr  # half a second to import, which `record` and `replay` need not wait

OtherSite = Annotated[
    Path | None, typer.Option(help="The site file, if not the one in the session.")
]
Session = Annotated[Path, typer.Argument(help="An .mcap file, or a folder with one.")]
Web = Annotated[
    bool, typer.Option("--web", help="Serve to a browser on this machine and print the address.")
]

Port = Annotated[
    int,
    typer.Option(
        help="Of the page with --web; the data are at the next port. 0: ports that are free.",
        min=0,
        max=65534,
    ),
]
Host = Annotated[
    str, typer.Option(help="The address of this machine that --web is open to; else itself alone.")
]

_FLUSH_TIMEOUT_S = 1.0
_ANSWER_S = 10.0  # a recorder that saves a ring writes some hundred megabytes first
_LOOK_PERIOD_S = 0.2


def record(
    site: SiteFile = SITE_FILE,
    out: Annotated[
        Path | None,
        typer.Option(
            help="The session's folder; without it, a new one in the recorder's directory "
            "of the site file.",
            file_okay=False,
        ),
    ] = None,
    ring: Annotated[
        str,
        typer.Option(
            metavar="60s",
            help="Keep the last seconds in memory only, and write them when a camera was moved "
            "or on `--remote save`.",
        ),
    ] = "",
    remote: Annotated[
        str,
        typer.Option(
            metavar="|".join(recorder.COMMANDS),
            help="Tell the site's recorder, wherever it runs, and end.",
        ),
    ] = "",
    metrics: MetricsAt = "",
) -> None:
    """Record every key of the site to an MCAP file until stopped (Ctrl-C).

    Pictures are recorded where the site file says `pictures = true` under [recorder].
    """
    loaded = load_site(site)
    if remote:
        tell_recorder(loaded, remote)
        return
    clock = SystemClock()
    path = recorder.session_path(loaded, out, now_ns=clock.now_ns())
    ring_s = _seconds(ring, "--ring") if ring else 0.0
    with open_bus(loaded, (Kind.RECORDER, recorder.NAME)) as bus:
        node = Node(bus, site=loaded.name, kind=recorder.KIND, name=recorder.NAME)
        stopped_by_signals(node)  # before there is anything to close
        with (
            metrics_served(loaded, metrics, [node]),
            recorder.Recorder(loaded, path, clock=clock, out=out, ring_s=ring_s) as session,
            node,
        ):
            session.start(bus, node)
            what = f"keeping the last {ring_s:g} s of" if ring_s else "recording"
            typer.echo(f"{what} site {loaded.name} to {path}")
            node.wait()
    if session.last is not None:
        _say_recorded(session.last)


def tell_recorder(site: Site, command: str) -> None:
    """Send one command to the recorder of a site and print what it replies, JSON."""
    if command not in recorder.COMMANDS:
        known = ", ".join(recorder.COMMANDS)
        raise InputError(f"--remote {command}: there is no such command; give one of {known}")
    with open_bus(site, patience_s=_ANSWER_S) as bus:
        replies = bus.query(command_key(site.name, f"recorder/{command}"), timeout_s=_ANSWER_S)
    if not replies:
        raise OperationError(
            f"no recorder answers on site {site.name}; start one with `trigpoint record`"
        )
    for reply in replies:
        if reply.error:
            raise OperationError(reply.error)
        typer.echo(reply.payload.decode())


def _seconds(text: str, option: str) -> float:
    """«60», «60s», «2min» as seconds; raise InputError for anything else."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(s|min)?", text.strip())
    if match is None or not float(match[1]):
        raise InputError(f"{option} {text}: this is no duration; write one like 60s")
    return float(match[1]) * (60.0 if match[2] == "min" else 1.0)


def view(
    site: SiteFile = SITE_FILE, web: Web = False, port: Port = WEB_PORT, host: Host = LOOPBACK
) -> None:
    """Show the live site in rerun until stopped (Ctrl-C) or until its window is closed."""
    from .viewer.live import KIND, LiveView

    loaded = load_site(site)
    targets = {
        robot: load_target(loaded.path(loaded.target_name(robot))) for robot in loaded.robots
    }
    with open_bus(loaded) as bus:
        node = stopped_by_signals(Node(bus, site=loaded.name, kind=KIND, name=_own_name()))
        with (
            _viewer(None, web, port, host) as viewer,
            _streaming(loaded.name, viewer) as stream,
            node,
        ):
            LiveView(loaded, targets, stream).start(bus, node)
            node.thread("viewer", lambda: _watch(viewer, node))
            _say_viewer(viewer)
            _say_board(web)
            node.wait()


def review(
    session: Session,
    web: Web = False,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.rrd", help="Write a rerun file and open nothing.", dir_okay=False
        ),
    ] = None,
    overlay: Annotated[
        list[Path],
        typer.Option(help="A network.json or truth.json to draw too; those beside it always are."),
    ] = [],  # noqa: B006 - typer makes a list of it anew
    site: OtherSite = None,
    port: Port = WEB_PORT,
    host: Host = LOOPBACK,
) -> None:
    """Show a recorded session in rerun."""
    from .viewer.overlay import load_overlay, overlays_beside
    from .viewer.review import write_rrd

    recording = open_recording(session)
    given = load_site(site) if site else None
    overlays = [*overlays_beside(recording.folder), *map(load_overlay, overlay)]
    if save is not None:
        shown = write_rrd(recording, save, overlays, given=given)
        typer.echo(f"{save}: {shown} messages, {save.stat().st_size / 1e6:.1f} MB")
        return
    with tempfile.TemporaryDirectory(prefix="trigpoint-review-") as folder:
        file = Path(folder) / f"{recording.name}.rrd"
        write_rrd(recording, file, overlays, given=given)
        with _viewer(file, web, port, host) as viewer, suppress(KeyboardInterrupt):
            _say_viewer(viewer)
            while viewer.is_running:
                time.sleep(_LOOK_PERIOD_S)


def replay(
    session: Session,
    rate: Annotated[float, typer.Option(help="Times the recorded pace.", min=0.001)] = 1.0,
    keys: Annotated[
        str,
        typer.Option(
            metavar="EXPR",
            help="Only keys that match, e.g. 'camera/*/sightings' (* one chunk, ** any number).",
        ),
    ] = "**",
    from_s: Annotated[
        float, typer.Option("--from", metavar="S", help="Begin so many seconds in.", min=0.0)
    ] = 0.0,
    to_s: Annotated[
        float, typer.Option("--to", metavar="S", help="End so many seconds in.", min=0.0)
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Again and again, until stopped.")] = False,
    prefix: Annotated[
        str,
        typer.Option(
            help="Before the site's name on the bus, like again_: a site of its own, which never "
            "mixes with the live one."
        ),
    ] = "",
    site: Annotated[
        Path | None,
        typer.Option(help="Replay into this site, not into the one that the session has attached."),
    ] = None,
) -> None:
    """Put a session back on the bus with its bytes as they were recorded.

    Stamps in the messages stay those of the recording; only the pace is by the clock of now. Keys
    whose sender runs on the site now are left out, diagnostics always. In a terminal, space holds
    the replay, s puts one message, q ends it.
    """
    if to_s and to_s <= from_s:
        raise InputError(f"--to {to_s:g} is not after --from {from_s:g}; give a later end")
    recording = open_recording(session)
    loaded = _prefixed(load_site(site) if site else _attached(recording), prefix)
    span = span_of(recording.start_ns, from_s, to_s, loops=loop)
    controls = Controls()
    with open_bus(loaded) as bus:
        plan = player.plan(recording, bus, site=loaded.name, keys=keys)
        node = Node(bus, site=loaded.name, kind="replay", name=_own_name())
        with stopped_by_signals(node), keyboard(controls, node.stop) as has_keys:
            _say_plan(recording, plan, loaded.name, rate)
            if has_keys:
                typer.echo("space: hold, s: one message, q: end")
            counts = player.replay(
                recording,
                bus,
                plan.routes,
                rate=rate,
                clock=SystemClock(),
                stopping=node.stopping,
                span=span,
                controls=controls,
            )
    for key, count in counts.items():
        typer.echo(f"{count:8d}  {key}")
    typer.echo(f"{sum(counts.values()):8d}  messages put on site {loaded.name}")


def _prefixed(site: Site, prefix: str) -> Site:
    if not re.fullmatch(r"(?:[a-z][a-z0-9_]*)?", prefix) or "__" in prefix + site.name:
        raise InputError(f"--prefix {prefix}: write lower-case letters, like again_")
    return msgspec.structs.replace(site, name=prefix + site.name)


def _attached(recording: Recording) -> Site:
    file = f"{recording.path}: site.toml"
    return parse_site(recording.site_text, directory=recording.folder, file=file)


@contextmanager
def _streaming(site: str, viewer: Viewer) -> "Iterator[rr.RecordingStream]":
    """A recording that goes to the viewer; it is ended before the viewer, as far as that runs."""
    from .viewer.columns import open_stream

    stream = open_stream(site, time.time_ns())
    stream.connect_grpc(viewer.stream_url)
    try:
        yield stream
    finally:
        if viewer.is_running:
            with suppress(RuntimeError):  # it ended just now: nobody is there to be shown the rest
                stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
        stream.disconnect()


def _viewer(file: Path | None, web: bool, port: int, host: str) -> Viewer:
    if web and host != LOOPBACK:
        typer.echo(
            f"warning: whoever reaches {host}:{port} sees everything of this site; a tunnel "
            f"(ssh -L {port}:{LOOPBACK}:{port} -L {port + 1}:{LOOPBACK}:{port + 1}) shows it to "
            "you alone",
            err=True,
        )
    return Viewer(file, is_web=web, port=port if web else 0, host=host if web else LOOPBACK)


def _own_name() -> str:
    """Any number of views and replays may run on a site."""
    return f"p{os.getpid()}"


def _watch(viewer: Viewer, node: Node) -> None:
    """A closed window ends the view."""
    while not node.stopping.wait(_LOOK_PERIOD_S):
        if not viewer.is_running:
            node.stop()


def _say_viewer(viewer: Viewer) -> None:
    if viewer.web_url:
        typer.echo(f"open in a browser on this machine: {viewer.web_url}")


def _say_board(web: bool) -> None:
    """Measured in a browser without a graphics card: 46 s behind after 65 s."""
    if web:
        typer.echo(
            "without a graphics card a browser draws rerun's view ever later than it happens; to "
            "watch a site, open the page of `trigpoint board`"
        )


def _say_plan(recording: Recording, plan: player.Plan, site: str, rate: float) -> None:
    seconds = to_seconds(recording.end_ns - recording.start_ns) / rate
    typer.echo(f"replaying {len(plan.routes)} keys on site {site}, {seconds:.0f} s at {rate:g} ×")
    for key, reason in plan.left_out.items():
        typer.echo(f"left out: {key}: {reason}")


def _say_recorded(sink: McapSink) -> None:
    counts, files = sink.counts, sink.files
    for key, count in counts.items():
        typer.echo(f"{count:8d}  {key}")
    if not counts:
        typer.echo(
            "nothing was sent on the site while it was recorded; `trigpoint status` shows it"
        )
    size = sum(file.stat().st_size for file in files) / 1e6
    where = files[0] if len(files) == 1 else sink.path.parent
    typer.echo(f"{sum(counts.values()):8d}  messages, {size:.1f} MB, {sink.lost} lost: {where}")
    if removed := sink.part - len(files):
        typer.echo(f"of {counted(sink.part, 'file')} the oldest {removed} made room for the others")
