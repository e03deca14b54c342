"""The command `detect`: the sightings in pictures, folders of pictures and videos."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from msgspec import Struct

from trigpoint.base.errors import InputError, writing
from trigpoint.base.words import counted
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.detector import detector_for
from trigpoint.edge.image.picture import as_grey
from trigpoint.edge.sources.opencv_log import quieten_opencv
from trigpoint.edge.sources.picture_files import (
    check_orientations,
    is_picture,
    pictures_in,
    read_picture,
)
from trigpoint.recorder.mcap.rosbag_metadata import is_bag
from trigpoint.site.target import load_target

from .account import PictureAccount

Given = Path | np.ndarray
"""A picture file, a folder of them, a video or a bag; or a picture itself, grey or BGR."""
_COLOURS = ((40, 160, 255), (80, 220, 80), (255, 140, 60), (220, 80, 220), (60, 220, 220))
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_READABLE_WIDTH = 1200
LEAST_PICTURES = 10
"""So many pictures with nothing in them are worth a word."""
NOTHING_NEAR = (
    "no board near to the target file's is in them either; compare its pattern, columns, rows and "
    "dictionary with the print, and see that the board is sharp, whole, and large enough"
)


class Still(Struct, frozen=True):
    """One grey picture; `name`: its name in the output; `stem`: in drawings."""

    name: str
    stem: str
    picture: np.ndarray


def main(
    pictures: Annotated[
        list[Path], typer.Argument(help="Pictures, folders of them, videos, or bags.")
    ],
    target: Annotated[Path, typer.Option(help="The target file.")],
    json_lines: Annotated[
        bool, typer.Option("--json", help="One JSON object a line for each picture.")
    ] = False,
    draw: Annotated[
        Path | None, typer.Option(help="Folder for the pictures with what was found drawn in.")
    ] = None,
    topic: Annotated[
        list[str], typer.Option(help="Of a bag (MCAP, rosbag2, ROS 1): the pictures' topic.")
    ] = [],  # noqa: B006 - typer makes a list of it anew
    sequence: Annotated[
        bool, typer.Option("--sequence", help="They are one camera's, in order, of one size.")
    ] = False,
) -> None:
    """The faces of a target in pictures: which, where their corners are, and how well known."""
    quieten_opencv()
    cv2.setNumThreads(1)  # like the agent, so that the times are comparable
    wanted = load_target(target)
    detector = detector_for([wanted])
    check_all(pictures)
    if draw is not None:
        _make_folder(draw)
    first: Still | None = None
    said: set[str] = set()
    total, account = _Sum(), PictureAccount()
    for still in stills(pictures, topic, account):
        first = first or still
        if sequence and still.picture.shape != first.picture.shape:
            raise InputError(f"{still.name}: not of the size of {first.name}; leave --sequence out")
        began_s = time.perf_counter()
        faces = detector.detect(still.picture)
        milliseconds = (time.perf_counter() - began_s) * 1e3
        total.add(faces)
        typer.echo((_json if json_lines else _text)(still, faces, milliseconds))
        for line in detector.misdescribed:
            if line not in said:
                typer.echo(f"{target}: {line}", err=True)
        said.update(detector.misdescribed)
        if draw is not None:
            _write(draw / f"{still.stem}.png", draw_faces(still.picture, faces))
    for line in (*account.lines(), total.line):
        typer.echo(line, err=True)
    if total.is_nothing and not said:
        from .unlike import greys_seen, squares_seen  # of pictures that were read already

        seen = squares_seen(pictures, topic) or greys_seen(pictures, topic)
        typer.echo("; ".join(filter(None, [seen, NOTHING_NEAR])), err=True)


class _Sum:
    def __init__(self) -> None:
        self._pictures = self._with_faces = self._faces = 0

    def add(self, faces: tuple[FaceSighting, ...]) -> None:
        self._pictures += 1
        self._with_faces += bool(faces)
        self._faces += len(faces)

    @property
    def line(self) -> str:
        """The totals."""
        return (
            f"{counted(self._pictures, 'picture')}: {counted(self._faces, 'face')} in "
            f"{self._with_faces} of them"
        )

    @property
    def is_nothing(self) -> bool:
        """Whether nothing was found in many pictures."""
        return not self._faces and self._pictures >= LEAST_PICTURES


def stills(
    given: Sequence[Given], topics: Sequence[str] = (), account: PictureAccount | None = None
) -> Iterator[Still]:
    """Every picture of files, folders, videos and bags, and those given themselves, in order;
    raises InputError.

    `topics`: of bags, those with the pictures; none: the only one that has some. `account`: takes
    what is left out.
    """
    names: dict[str, int] = {}
    account = account or PictureAccount()
    for number, one in enumerate(given):
        for name, stem, picture in _opened(one, number, topics, account):
            account.add(name, picture)
            names[stem] = names.get(stem, 0) + 1
            unique = stem if names[stem] == 1 else f"{stem}_{names[stem]}"
            yield Still(name, unique, as_grey(picture))


def _opened(
    path: Given, number: int, topics: Sequence[str], account: PictureAccount
) -> Iterator[tuple[str, str, np.ndarray]]:
    if isinstance(path, np.ndarray):
        yield f"#{number}", f"{number:05d}", path
    elif is_bag(path):
        from .bag import bag_pictures  # the readers of bags take half a second to import

        yield from bag_pictures(path, topics, account)
    elif files := _picture_files(path):
        for file in files:
            try:
                picture = read_picture(file)
            except InputError as reason:
                account.leave_out(reason)
                continue
            yield str(file), file.stem, picture
    else:
        yield from _frames(path, account)


def _picture_files(path: Path) -> list[Path]:
    """Those of a folder, or the one that the path is; none of a bag or video."""
    if is_bag(path):
        return []
    if path.is_dir():
        return pictures_in(path)
    return [path] if is_picture(path) else []


def _frames(path: Path, account: PictureAccount) -> Iterator[tuple[str, str, np.ndarray]]:
    """The pictures of a video, named by number from 0; none of a file that is no video."""
    from trigpoint.edge.sources.frames_video import Video  # needs the streams extra

    try:
        video = Video(path)
    except InputError as reason:
        account.leave_out(reason)
        return
    try:
        number = 0
        while video.advance() is not None:
            picture = video.picture()
            if picture is None:
                account.leave_out(InputError(f"{path}: picture {number} is damaged"))
            else:
                yield f"{path}#{number}", f"{path.stem}_{number:05d}", picture
            number += 1
    finally:
        video.close()


def check_all(given: Sequence[Given]) -> None:
    """Raise InputError for a missing path, or pictures turned differently, before any work is
    done."""
    paths = [one for one in given if isinstance(one, Path)]
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: there is no such picture, folder or video; check the path")
    check_orientations(file for path in paths for file in _picture_files(path))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        text = f"{folder}: this folder cannot be made ({reason.strerror}); give another --draw"
        raise InputError(text) from None


def _write(file: Path, picture: np.ndarray) -> None:
    with writing(file):
        file.write_bytes(cv2.imencode(".png", picture)[1].tobytes())


def _json(still: Still, faces: tuple[FaceSighting, ...], milliseconds: float) -> str:
    height, width = still.picture.shape
    return json.dumps(
        {
            "picture": still.name,
            "width": width,
            "height": height,
            "milliseconds": round(milliseconds, 3),
            "faces": [_face(face) for face in faces],
        }
    )


def _face(face: FaceSighting) -> dict[str, object]:
    return {
        "face": face.face,
        "corners": face.corners.tolist(),
        "pixels": [[round(float(u), 4), round(float(v), 4)] for u, v in face.pixels],
        "sigma": round(face.sigma, 4),
    }


def _text(still: Still, faces: tuple[FaceSighting, ...], milliseconds: float) -> str:
    height, width = still.picture.shape
    found = "; ".join(
        f"{'a face' if face.face < 0 else f'face {face.face}'}: {len(face.corners)} corners, "
        f"sigma {face.sigma:.2f} px"
        for face in faces
    )
    return f"{still.name} ({width} × {height}, {milliseconds:.1f} ms): {found or 'nothing found'}"


def draw_faces(picture: np.ndarray, faces: tuple[FaceSighting, ...]) -> np.ndarray:
    """The grey picture as BGR, enlarged if small, with corners, their ids and the face's name near
    corner 0."""
    scale = max(1, round(_READABLE_WIDTH / picture.shape[1]))
    large = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    canvas = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    for number, face in enumerate(faces):
        _draw_one(canvas, face, scale, _COLOURS[number % len(_COLOURS)])
    return canvas


def _draw_one(
    canvas: np.ndarray, face: FaceSighting, scale: int, colour: tuple[int, int, int]
) -> None:
    # The centre of pixel (0, 0) is at ((scale - 1) / 2) in the enlarged picture.
    points = face.pixels * scale + (scale - 1) / 2
    for corner, point in zip(face.corners.tolist(), points, strict=True):
        x, y = (round(float(value)) for value in point)
        cv2.circle(canvas, (x, y), 4, colour, 1, cv2.LINE_AA)
        cv2.circle(canvas, (x, y), 0, (0, 0, 255), 1)
        cv2.putText(canvas, str(corner), (x + 5, y - 3), _FONT, 0.35, colour, 1, cv2.LINE_AA)
    x, y = (round(float(value)) for value in points.min(axis=0))
    which = f"face {face.face}" if face.face >= 0 else "a face"
    name = f"{face.target or 'any target'}: {which}, {len(points)} corners, {face.sigma:.2f} px"
    cv2.putText(canvas, name, (x, max(12, y - 14)), _FONT, 0.5, colour, 1, cv2.LINE_AA)
