"""`doctor`'s checks of a camera: opens it as the agent would and watches for a moment; looks at the
boards in its pictures, if they are files on this machine."""

import threading
from itertools import islice

from msgspec import Struct

from trigpoint.base.checks import Check, Level
from trigpoint.base.clock import SteadyClock, to_ns, to_seconds
from trigpoint.base.errors import InputError, OperationError, TrigpointError
from trigpoint.base.words import counted
from trigpoint.edge.detector import detector_for
from trigpoint.edge.sources.frames import Frame, FrameSource, Unreadable, open_source
from trigpoint.edge.sources.opencv_log import quieten_opencv
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config import Site
from trigpoint.site.target import load_target
from trigpoint.tools.pictures.account import PictureAccount
from trigpoint.tools.pictures.detect import stills
from trigpoint.tools.pictures.unlike import greys_seen, squares_seen

LOOK_S = 3.0
_OPENING_S = 8.0
_STILL_SCHEMES = ("dir", "file")
# This many pictures suffice to see how a board is printed, and take a second.
_PICTURES = 10
_SLOW = 0.7
"""A camera that gives less than this share of its `rate` is reported."""
_OLD_S = 1.0
_COMPARE = "and none of the target file's; compare its pattern, columns and rows with the print"


class Glance(Struct, frozen=True):
    """What arrived in a moment: pictures, their size, rate and age, and the clock of their
    stamps."""

    pictures: int
    width: int
    height: int
    rate: float
    age_s: float
    stamp: str


def check_camera(site: Site, name: str) -> list[Check]:
    """Whether a camera opens, and its pictures fit the site file and its lens."""
    if site.camera(name).scheme == "sim":
        return []
    try:
        glance = look_at(site, name)
    except (InputError, OperationError) as reason:
        remedy = "fine where it is another machine's; else see that it is on and correct `source`"
        level = "error" if isinstance(reason, InputError) else "warning"
        return [Check(f"camera {name}", level, str(reason), remedy)]
    if isinstance(glance, Unreadable):
        text = f"opens, but gave no picture that can be read; {glance.reason}"
        return [Check(f"camera {name}", "error", text, "see its cable, network and format")]
    if glance is None:
        text = f"opens, but gave no picture in {LOOK_S + _OPENING_S:.0f} s"
        return [Check(f"camera {name}", "error", text, "see whether it is on")]
    return [_picture_check(site, name, glance), *_lens_check(site, name, glance)]


def look_at(site: Site, name: str) -> Glance | Unreadable | None:
    """Open a camera's source and watch for a moment; the last damaged picture if none was whole,
    None if none arrived. Raises what the source raises."""
    quieten_opencv()
    config, clock, stopping = site.camera(name), SteadyClock(), threading.Event()
    source = open_source(config.source, config, clock=clock, directory=site.directory)
    timer = threading.Timer(LOOK_S + _OPENING_S, stopping.set)
    timer.start()
    try:
        return _glance(source, stopping, clock)
    finally:
        timer.cancel()
        stopping.set()
        source.close()


def _glance(
    source: FrameSource, stopping: threading.Event, clock: SteadyClock
) -> Glance | Unreadable | None:
    began_ns: int | None = None
    damaged: Unreadable | None = None
    frames: list[Frame] = []
    ages_s: list[float] = []
    for frame in source.frames(stopping):
        if not isinstance(frame, Frame):
            damaged = frame or damaged
            continue
        now_ns = clock.elapsed_ns()
        began_ns = began_ns or now_ns
        frames.append(frame)
        ages_s.append(to_seconds(clock.now_ns() - frame.captured_ns))
        if now_ns - began_ns >= to_ns(LOOK_S):
            break
    if not frames:
        return damaged
    height, width = frames[-1].picture.shape[:2]
    seconds = to_seconds(frames[-1].captured_ns - frames[0].captured_ns)
    rate = (len(frames) - 1) / seconds if seconds > 0 else 0.0
    return Glance(len(frames), width, height, rate, max(ages_s), frames[-1].stamp.value)


def _picture_check(site: Site, name: str, glance: Glance) -> Check:
    config = site.camera(name)
    text = (
        f"{glance.width} × {glance.height}, {counted(glance.pictures, 'picture')} at "
        f"{glance.rate:.1f} Hz, at most {glance.age_s:.2f} s old, stamped {glance.stamp}"
    )
    if (glance.width, glance.height) != (config.width, config.height):
        remedy = f"write width = {glance.width} and height = {glance.height}"
        text = f"{text}; the site file says {config.width} × {config.height}"
        return Check(f"camera {name}", "error", text, remedy)
    is_live = config.scheme not in _STILL_SCHEMES
    if is_live and glance.age_s > _OLD_S:
        remedy = "see what holds its pictures up: buffers, network, clock"
        return Check(f"camera {name}", "warning", text, remedy)
    if is_live and glance.rate < _SLOW * config.rate:
        remedy = "see its light and exposure, or correct `rate`"
        return Check(f"camera {name}", "warning", f"{text}; `rate` is {config.rate:g}", remedy)
    return Check(f"camera {name}", "ok", text)


def _lens_check(site: Site, name: str, glance: Glance) -> list[Check]:
    config = site.camera(name)
    if config.intrinsics is None or config.estimates_intrinsics:
        return []
    path = site.path(config.intrinsics)
    try:
        lens = read_camera_info(path)
    except InputError as reason:
        remedy = "make one with `trigpoint intrinsics`"
        return [Check(f"lens of {name}", "error", str(reason), remedy)]
    if (lens.width, lens.height) != (glance.width, glance.height):
        text = f"{path} is for {lens.width} × {lens.height}"
        remedy = "make one from pictures of this size with `trigpoint intrinsics`"
        return [Check(f"lens of {name}", "error", text, remedy)]
    return [Check(f"lens of {name}", "ok", f"{path}, {lens.width} × {lens.height}")]


def check_boards(site: Site, camera: str) -> list[Check]:
    """Boards that the target files describe wrongly; live cameras are left to their agents."""
    config = site.camera(camera)
    if config.scheme not in _STILL_SCHEMES or config.file is None:
        return []
    if not site.path(config.file).exists():  # said of the camera
        return []
    try:
        targets = [load_target(site.path(name)) for name in site.target_names]
        detector = detector_for(targets)
        account = PictureAccount()
        given = [site.path(config.file)]
        found = 0
        for still in islice(stills(given, account=account), _PICTURES):
            found += len(detector.detect(still.picture))
        said = account.lines()
        told: list[tuple[Level, str]] = [("error", line) for line in detector.misdescribed]
        if not (found or told):
            squares = squares_seen(given)
            seen = f"{squares}, {_COMPARE}" if squares else greys_seen(given)
            told = [("warning", seen)] if seen else []
    except TrigpointError as reason:
        return [Check(f"pictures of {camera}", "warning", str(reason), "mend the source")]
    pictures = [Check(f"pictures of {camera}", "warning", line) for line in said]
    # Each says what is wrong, and after the last semicolon what to do.
    boards = [
        Check(f"boards of {camera}", level, *line.rpartition("; ")[::2]) for level, line in told
    ]
    return pictures + boards
