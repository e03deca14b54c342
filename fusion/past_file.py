"""The file of what a map keeps of its past (`model/past`); the checkpoint has what came since.

msgpack behind a head and a checksum. It is replaced whole, so that a killed fusion leaves the one
before, with which the checkpoint still has every message that it needs.
"""

import logging
from pathlib import Path

import msgspec
import numpy as np

from trigpoint.base.errors import OperationError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import IntrinsicsRecord
from trigpoint.site.config import Site
from trigpoint.site.target import Target

from .checked_file import checked_body, save_checked
from .checkpoint import set_aside
from .model.assembly import estimates_faces, estimates_scales
from .model.known_cameras import Creep, KnownCameras
from .model.past import Past, PastCamera

_MAGIC = b"trigpoint-past/1\n"

_log = logging.getLogger(__name__)


class _Document(msgspec.Struct):
    """Poses are rows of twelve numbers (`Pose.rows`); all arrays are little-endian doubles."""

    site: str
    since_ns: dict[str, int]
    map_since_ns: int | None
    epoch_ns: int
    until_ns: int | None
    poses: dict[str, bytes]
    faces: dict[str, bytes]
    values: list[tuple[str, str, bytes]]
    information: bytes
    lenses: dict[str, IntrinsicsRecord]
    cameras: dict[str, PastCamera]


def save_past(path: Path, past: Past, site: Site) -> None:
    """Replace the file; raise OSError where the disk does not take it."""
    save_checked(path, _MAGIC, msgspec.msgpack.encode(_document(past, site)))


def load_past(path: Path, site: Site, targets: dict[str, Target]) -> Past | None:
    """The past of a map; None where there is none. Of cameras and robots that the site file lost,
    and of what it does not estimate any more, nothing is taken. Where the file is damaged, or no
    camera is left, that is logged, the file kept under another name, and None returned. Raises
    OperationError for another site's."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    document = _read(data)
    if document is None:
        _log.error(
            "%s is damaged, and the map's past lost with it; a new map begins with what came since "
            "(the file is kept as %s)",
            path,
            set_aside(path),
        )
        return None
    if document.site != site.name:
        raise OperationError(
            f"{path}: the past of another site ({document.site}); give another --out"
        )
    past = _past(document, site, targets)
    if past.known.poses:
        return past
    _log.error(
        "%s: it knows none of this site's cameras; a new map begins (the file is kept as %s)",
        path,
        set_aside(path),
    )
    return None


def _read(data: bytes) -> _Document | None:
    """What a file says; None where it is not whole."""
    body = checked_body(data, _MAGIC)
    try:
        return None if body is None else msgspec.msgpack.decode(body, type=_Document)
    except msgspec.DecodeError:
        return None


def _document(past: Past, site: Site) -> _Document:
    known = past.known
    return _Document(
        site=site.name,
        since_ns=dict(past.since_ns),
        map_since_ns=past.map_since_ns,
        epoch_ns=past.epoch_ns,
        until_ns=known.until_ns,
        poses={name: _bytes(pose.rows()) for name, pose in known.poses.items()},
        faces={name: _bytes(faces.rows()) for name, faces in known.faces.items()},
        values=[(kind, name, _bytes(value)) for (kind, name), value in known.values.items()],
        information=_bytes(known.information),
        lenses={
            name: IntrinsicsRecord.of(lens, np.zeros(len(lens.parameters)))
            for name, lens in past.lenses.items()
        },
        cameras=dict(past.cameras),
    )


def _past(document: _Document, site: Site, targets: dict[str, Target]) -> Past:
    information = _numbers(document.information)
    size = round(len(information) ** 0.5)
    known = KnownCameras(
        poses={name: _poses(rows)[0] for name, rows in document.poses.items()},
        information=information.reshape(size, size),
        until_ns=document.until_ns,
        creep=Creep.of_all(site.cameras),
        faces={name: _poses(rows) for name, rows in document.faces.items()},
        values={(kind, name): _numbers(value) for kind, name, value in document.values},
    )
    lenses = {name: record.camera for name, record in document.lenses.items()}
    return Past(
        known=known.without(lambda kind, name: not _is_of_site(known, site, targets, kind, name)),
        since_ns={name: ns for name, ns in document.since_ns.items() if name in site.robots},
        map_since_ns=document.map_since_ns,
        epoch_ns=document.epoch_ns,
        lenses={name: lens for name, lens in lenses.items() if name in site.cameras},
        cameras=document.cameras,
    )


def _is_of_site(
    known: KnownCameras, site: Site, targets: dict[str, Target], kind: str, name: str
) -> bool:
    """Whether a part of what is known is something that the site still has, or estimates."""
    if name not in (site.robots if kind in ("scales", "faces") else site.cameras):
        return False
    if kind == "lens":
        return site.cameras[name].estimates_intrinsics
    if kind == "clock":
        return site.cameras[name].time_offset_sigma > 0
    if kind == "scales":
        return estimates_scales(site.robots[name].odometry)
    if kind == "faces":
        has_as_many = len(known.faces[name]) == len(targets[name].faces)
        return has_as_many and estimates_faces(site.fusion)
    return True


def _bytes(array: Array) -> bytes:
    return np.asarray(array, dtype="<f8").tobytes()


def _numbers(data: bytes) -> Array:
    return np.frombuffer(data, dtype="<f8").astype(float)


def _poses(data: bytes) -> Pose:
    return Pose.from_rows(_numbers(data).reshape(-1, 12))
