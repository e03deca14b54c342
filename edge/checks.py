"""What `doctor` looks at for the edge agent."""

import os
from collections.abc import Sequence
from pathlib import Path

from trigpoint.base.checks import Check
from trigpoint.base.words import install_command

from .sources.v4l2_formats import Offer, offers_of


def checks() -> list[Check]:
    """Can OpenCV be used, are there cameras, and may this user open them?"""
    return [_opencv(), *_cameras()]


def _opencv() -> Check:
    try:
        import cv2
    except ImportError as reason:
        remedy = "pip install -c constraints.txt --force-reinstall opencv-python-headless"
        return Check("edge", "error", f"OpenCV cannot be loaded ({reason})", remedy)
    if int(cv2.__version__.partition(".")[0]) < 5:
        remedy = install_command("edge")
        return Check("edge", "error", f"OpenCV {cv2.__version__} is too old", remedy)
    return Check("edge", "ok", f"OpenCV {cv2.__version__}")


def _cameras() -> list[Check]:
    devices = sorted(Path("/dev").glob("video[0-9]*"))
    if not devices:
        remedy = "plug one in; network cameras and files need none"
        return [Check("cameras", "warning", "this machine has no camera (/dev/video*)", remedy)]
    return [_access(device) for device in devices]


def _access(device: Path) -> Check:
    if not os.access(device, os.R_OK | os.W_OK):
        remedy = "add this user to the group «video» (usermod -aG video) and log in again"
        return Check("camera", "error", f"{device} may not be opened by this user", remedy)
    try:
        offers = offers_of(device)
    except OSError as reason:
        remedy = "see which program uses it (fuser -v), or plug it in again"
        return Check("camera", "warning", f"{device} cannot be asked ({reason.strerror})", remedy)
    if not offers:
        return Check("camera", "ok", f"{device} gives no pictures (a camera's second device)")
    return Check("camera", "ok", f"{device} gives {described(offers)}")


def described(offers: Sequence[Offer]) -> str:
    """Formats with their sizes and highest rates, in a line."""
    sizes: dict[str, list[str]] = {}
    for offer in offers:
        rate = f" at {offer.rate:.0f} Hz" if offer.rate else ""
        sizes.setdefault(offer.format, []).append(f"{offer.width} × {offer.height}{rate}")
    return "; ".join(f"{name}: {', '.join(known)}" for name, known in sizes.items())
