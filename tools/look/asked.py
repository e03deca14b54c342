"""What a line of `look` names: a source of pictures, their size, a target."""

import re
from pathlib import Path

from trigpoint.base.errors import InputError
from trigpoint.site.target import NOWHERE, Face, Pattern, Target, load_target, parse_target
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.site.file import first_target_text

TARGET_HERE = Path("target.toml")
_SIZE = re.compile(r"(\d+)[x×](\d+)")
_SQUARE = 0.03
"""Of a board that is only counted, metres: the size of a plane does not enter the lens."""


def source_url(text: str) -> str:
    """A source as a URL; a device, a video or a folder may be given by its path, a camera by its
    number. Raises InputError."""
    if "://" in text:
        return text
    if text.isdigit():
        return f"v4l2://{text}"
    if not text.startswith("/dev/") and not Path(text).exists():
        raise InputError(
            f"{text}: there is no such video or folder; give one, or a camera, as "
            "v4l2:///dev/video0 or rtsp://HOST/PATH"
        )
    return url_of(text)


def url_of(path: str) -> str:
    """The source that is a device, a folder of pictures or a video."""
    if path.startswith("/dev/"):
        return f"v4l2://{path}"
    return f"{'dir' if Path(path).is_dir() else 'file'}://{path}"


def picture_size(text: str) -> tuple[int, int]:
    """Width and height, as of 1280x720; raises InputError."""
    numbers = _SIZE.fullmatch(text)
    width, height = (0, 0) if numbers is None else map(int, numbers.groups())
    if not width or not height:
        raise InputError(f"--size {text}: give width and height in pixels, like 1280x720")
    return width, height


def chosen_target(text: str | None, scheme: str) -> Target:
    """The target that is looked for; raises InputError.

    Without one the ./target.toml, else `charuco`: the target that `init` writes, or what simulated
    robots carry. `checkerboard` is their other one; `checkerboard:10x7` any, by its squares.
    """
    if text is None:
        text = str(TARGET_HERE) if TARGET_HERE.exists() else "charuco"
    if text == "charuco":
        is_simulated = scheme == "sim"
        return target_of(text) if is_simulated else parse_target(first_target_text())
    if text == "checkerboard":
        return target_of(text)
    name, _, counts = text.partition(":")
    if name == "checkerboard":
        return _counted_board(counts)
    if not text.endswith(".toml"):
        raise InputError(
            f"--target {text}: name charuco, checkerboard, checkerboard:COLUMNSxROWS (squares), or "
            "a target file, FILE.toml"
        )
    return load_target(Path(text))


def _counted_board(counts: str) -> Target:
    numbers = _SIZE.fullmatch(counts)
    if numbers is None:
        raise InputError(
            f"--target checkerboard:{counts}: give how many squares it has, like checkerboard:10x7"
        )
    columns, rows = map(int, numbers.groups())
    try:
        face = Face(0, Pattern.CHECKERBOARD, columns, rows, _SQUARE, *NOWHERE)
    except ValueError as reason:
        raise InputError(f"--target checkerboard:{counts}: {reason}") from None
    return Target("board", (face,))
