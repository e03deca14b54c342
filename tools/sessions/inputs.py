"""The inputs for processing a recorded session: its site, targets and lenses."""

from collections.abc import Mapping
from pathlib import Path

from trigpoint.base.errors import InputError
from trigpoint.fusion.inputs import load_inputs, make_inputs
from trigpoint.fusion.model.inputs import Inputs
from trigpoint.geometry import CameraModel
from trigpoint.recorder.session.recording import Recording
from trigpoint.site.camera_info import parse_camera_info
from trigpoint.site.config import Site, load_site, parse_site
from trigpoint.site.target import parse_target


def session_inputs(
    recording: Recording,
    *,
    site: Path | None,
    network: Path | None,
    settings: Mapping[str, object] | None = None,
) -> Inputs:
    """Inputs by a site file, or by the one that is attached to the session; `settings`: as
    `load_site` takes them.

    Raises InputError where the session has none or lacks a file that it names.
    """
    if site is not None:
        return load_inputs(load_site(site, settings), network=network)
    attached = parse_site(
        recording.site_text,
        directory=recording.folder,
        file=f"{recording.path}: attached site.toml",
        settings=settings,
    )
    targets = {}
    for robot in attached.robots:
        name = attached.target_name(robot)
        targets[robot] = parse_target(_attachment(recording, name), file=f"attached {name}")
    return make_inputs(attached, targets, _attached_lenses(recording, attached), network=network)


def _attached_lenses(recording: Recording, site: Site) -> dict[str, CameraModel]:
    """Lenses from attached intrinsics files; those of other cameras are in their camera_info."""
    lenses = {}
    for name, camera in site.cameras.items():
        if camera.intrinsics is None or camera.estimates_intrinsics:
            continue
        text = _find(recording, camera.intrinsics)
        if text is not None:
            lenses[name] = parse_camera_info(text, file=f"attached {camera.intrinsics}")
    return lenses


def _attachment(recording: Recording, name: str) -> str:
    text = _find(recording, name)
    if text is None:
        raise InputError(
            f"{recording.path}: «{name}» is not attached; give the site file with --site"
        )
    return text


def _find(recording: Recording, name: str) -> str | None:
    """An attached file by the path in the site file, or by its file name."""
    for candidate in (name, Path(name).name):
        if candidate in recording.attachments:
            return recording.attachments[candidate].decode("utf-8", errors="replace")
    return None
