"""The file of what a map keeps of its past (`model/past`); the checkpoint has what came since.

msgpack behind a head and a checksum. It is replaced whole, so that a killed fusion leaves the one
before, with which the checkpoint still has every message that it needs.
"""

import logging
from pathlib import Path

import msgspec
from msgspec.structs import replace

from trigpoint.base.errors import OperationError
from trigpoint.site.config import Site
from trigpoint.site.target import Target

from .checked_file import checked_body, packed, save_checked, unpacked
from .checkpoint import set_aside
from .model.assembly import estimates_faces, estimates_scales
from .model.known_cameras import Creep, KnownCameras
from .model.past import Past

_MAGIC = b"trigpoint-past/2\n"

_log = logging.getLogger(__name__)


class _Document(msgspec.Struct):
    site: str
    past: Past


def save_past(path: Path, past: Past, site: Site) -> None:
    """Replace the file; raise OSError where the disk does not take it."""
    save_checked(path, _MAGIC, packed(_Document(site.name, past)))


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
    past = _of_site(document.past, site, targets)
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
        return None if body is None else unpacked(body, _Document)
    except ValueError:
        return None


def _of_site(past: Past, site: Site, targets: dict[str, Target]) -> Past:
    """What a past knows of cameras and robots that a site still has, and of what it estimates."""
    known = replace(past.known, creep=Creep.of_all(site.cameras))
    return replace(
        past,
        known=known.without(lambda kind, name: not _is_of_site(known, site, targets, kind, name)),
        since_ns={name: ns for name, ns in past.since_ns.items() if name in site.robots},
        lenses={name: lens for name, lens in past.lenses.items() if name in site.cameras},
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
