"""`trigpoint look`: one camera without a site file."""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from trigpoint.base.clock import SystemClock, to_ns
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import InputError, OperationError
from trigpoint.base.words import counted
from trigpoint.edge.lens.calibration_text import calibration_record, calibration_text
from trigpoint.edge.sources.frames import source_class
from trigpoint.edge.sources.opencv_log import quieten_opencv
from trigpoint.node.node import stop_on_signals
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config import CameraConfig

from .asked import chosen_target, picture_size, source_url
from .looking import Look, Result, Wishes
from .shown import Shown

PORT = 8421
_LINE_NS, _PAGE_NS = to_ns(2.0), to_ns(0.2)


def main(
    source: Annotated[
        str,
        typer.Argument(
            help="v4l2://, rtsp://, file://, dir:// or sim://; or the path of a device, a video or "
            "a folder of pictures."
        ),
    ],
    target: Annotated[
        str | None,
        typer.Option(
            help="charuco, checkerboard, checkerboard:10x7 (squares) or FILE.toml; else "
            "./target.toml, else charuco."
        ),
    ] = None,
    intrinsics: Annotated[
        Path | None, typer.Option(help="The lens, where it is known already; none is taken then.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Where the lens is written, ROS camera_info YAML; else the next free of "
            "c1.yaml, c2.yaml, …"
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write --out even where it is there already.")
    ] = False,
    size: Annotated[
        str, typer.Option(metavar="WxH", help="Picture size that a camera is asked for.")
    ] = "640x480",
    rate: Annotated[float, typer.Option(min=0.1, max=1000, help="Pictures a second at most.")] = 10,
    global_shutter: Annotated[
        bool,
        typer.Option(
            "--global-shutter", help="The camera exposes all rows at once: the board may move."
        ),
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.1, max=1e6, help="Look for so long, once it is open."),
    ] = None,
    port: Annotated[
        int, typer.Option(help="Of the page; 0: one that is free.", min=0, max=65535)
    ] = PORT,
    no_page: Annotated[
        bool, typer.Option("--no-page", help="The terminal only; ends when the lens is taken.")
    ] = False,
    json_text: Annotated[
        bool, typer.Option("--json", help="The result as one JSON object.")
    ] = False,
) -> None:
    """Look through one camera, without a site file: what it sees of a target, live on a page and in
    the terminal, and its lens, once the board was shown all over the picture.

    It runs until Ctrl-C; with --seconds or --no-page until then or the source's end, and with
    --no-page until the lens is taken.
    """
    url = source_url(source)
    width, height = picture_size(size)
    config = CameraConfig(url, width=width, height=height, rate=rate)
    source_class(config.scheme)
    wishes = Wishes(
        config,
        chosen_target(target, config.scheme),
        lens=None if intrinsics is None else read_camera_info(intrinsics),
        out=_out(out, is_known=intrinsics is not None, overwrite=overwrite),
        is_global=global_shutter,
        ends_when_taken=no_page,
        seconds=seconds,
    )
    quieten_opencv()
    cv2.setNumThreads(1)
    with ExitStack() as stack:
        teller = _Teller(is_json=json_text)
        if not no_page:
            teller.show_on_page(stack, port)
        look = Look(wishes, teller)
        stop_on_signals([look])
        result = look.run()
        _tell_result(result, look.name, is_json=json_text)
        is_failed = bool(result.missing) and not ENDING.is_asked
        if not no_page and seconds is None and not look.is_stopped:
            teller.say(f"{result.over}; the page stays until Ctrl-C")
            look.wait()
    if is_failed:
        raise OperationError(f"no lens was taken, so nothing is written: {result.missing}")


def _out(given: Path | None, *, is_known: bool, overwrite: bool) -> Path | None:
    """Where a lens is written; None where none is taken. Raises InputError rather than have a file
    overwritten that nobody said may be."""
    if given is None:
        return None if is_known else _free_name()
    if given.suffix not in (".yaml", ".yml"):
        raise InputError(f"{given}: a lens is written as YAML; end the name in .yaml")
    there = [path for path in (given, given.with_suffix(".html")) if path.exists()]
    if there and not overwrite:
        raise InputError(f"{there[0]} is there already; give another --out, or --overwrite")
    return given


def _free_name() -> Path:
    number = 1
    while any(Path(f"c{number}{end}").exists() for end in (".yaml", ".html")):
        number += 1
    return Path(f"c{number}.yaml")


class _Teller:
    """Says what is seen: on the page five times a second, in the terminal every two seconds and
    whenever there is other advice."""

    def __init__(self, *, is_json: bool) -> None:
        self._is_json, self._clock = is_json, SystemClock()
        self._moments = None
        self._said_ns = self._shown_ns = -_LINE_NS
        self._said: dict[str, str] = {}
        self._hints: set[str] = set()

    def show_on_page(self, stack: ExitStack, port: int) -> None:
        from .page import Moments, page_served  # --no-page needs no server

        self._moments = Moments()
        address = stack.enter_context(page_served(self._moments, port))
        self.say(f"open in a browser: {address}")

    def __call__(self, shown: Shown, picture: np.ndarray) -> None:
        now_ns = self._clock.elapsed_ns()
        is_news = bool(shown.over) or shown.advice != self._said.get("advice")
        if self._moments and (is_news or now_ns - self._shown_ns >= _PAGE_NS):
            self._shown_ns = now_ns
            self._moments.show(shown, picture)
        for hint in shown.hints:
            if hint not in self._hints:
                self._hints.add(hint)
                self.say(hint)
        self._say("advice", shown.advice)
        self._say("lens", shown.lens.summary if shown.lens else "")
        self._say("written", f"wrote {shown.written}" if shown.written else "")
        if now_ns - self._said_ns >= _LINE_NS and not shown.over:
            self._said_ns = now_ns
            self.say(shown.line)

    def _say(self, what: str, text: str) -> None:
        """A line where it is another than the last of its kind."""
        if text and text != self._said.get(what):
            self._said[what] = text
            self.say(f"  {text}")

    def say(self, text: str) -> None:
        typer.echo(text, err=self._is_json)


def _tell_result(result: Result, name: str, *, is_json: bool) -> None:
    if is_json:
        typer.echo(json.dumps(_record(result, name)))
        return
    typer.echo(
        f"{counted(result.pictures, 'picture')}, {result.with_target} with the target; "
        f"{counted(result.views, 'view')} kept"
    )
    if result.lens is not None:
        typer.echo(calibration_text(result.lens))
    for file in result.written:
        typer.echo(f"wrote {file}")


def _record(result: Result, name: str) -> dict[str, object]:
    width, height = result.size
    return {
        "source": name,
        "width": width,
        "height": height,
        "pictures": result.pictures,
        "with_target": result.with_target,
        "views": result.views,
        "hints": list(result.hints),
        "lens": None if result.lens is None else calibration_record(result.lens),
        "written": [str(file) for file in result.written],
        "missing": result.missing,
    }
