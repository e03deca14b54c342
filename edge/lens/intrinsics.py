"""Which lens a camera announces."""

import logging

from trigpoint.base.errors import ConfigError
from trigpoint.geometry import CameraModel
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config import CameraConfig, Site

_log = logging.getLogger(__name__)


def calibrated_lens(site: Site, camera: str) -> CameraModel | None:
    """The lens in the file that the site names, None where it names none; raises InputError."""
    config = site.camera(camera)
    if config.intrinsics is None or config.estimates_intrinsics:
        return None
    return read_camera_info(site.path(config.intrinsics))


def known_lens(
    site: Site, camera: str, calibrated: CameraModel | None, own: CameraModel | None
) -> CameraModel | None:
    """The lens to announce: the calibrated one, else the source's own, else none.

    A lens that is only supposed is never announced: whoever hears one takes it as known, and that
    spoils every result. Where it is to be estimated, fusion supposes it itself.
    """
    known = calibrated or own
    if known is None and not site.camera(camera).estimates_intrinsics:
        _log.warning(
            "camera %s has no intrinsics, so none are announced and fusion cannot use its "
            'sightings; make them with `trigpoint intrinsics`, or write intrinsics = "estimate"',
            camera,
        )
    return known


def check_size(
    camera: str, config: CameraConfig, lens: CameraModel | None, shape: tuple[int, ...]
) -> None:
    """Raise ConfigError where a picture is not of the size that the camera's lens says, or the site
    file where there is none; `shape`: rows, columns."""
    height, width = shape[:2]
    whose = lens or config
    if (width, height) == (whose.width, whose.height):
        return
    said = f"{whose.width} × {whose.height}"
    reason = f"its intrinsics are for {said}; give it those of this size, or set its source to it"
    if lens is None:
        reason = (
            f"the site file says {said}; write width = {width} and height = {height} under "
            f"[cameras.{camera}]"
        )
    raise ConfigError(f"camera {camera}: its pictures are {width} × {height}, but {reason}")
