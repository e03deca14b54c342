"""What `doctor` looks at for the edge agent."""

import importlib.util
import os
from pathlib import Path

from trigpoint.checks import Check


def checks() -> list[Check]:
    """Is the part installed, are there cameras, and may this user open them?"""
    if importlib.util.find_spec("cv2") is None:
        remedy = "pip install 'trigpoint[edge]'"
        return [Check("edge", "error", "OpenCV (cv2) is not installed", remedy)]
    return [_opencv(), *_cameras()]


def _opencv() -> Check:
    try:
        import cv2
    except ImportError as reason:
        remedy = "pip install --force-reinstall opencv-python-headless"
        return Check("edge", "error", f"OpenCV cannot be loaded ({reason})", remedy)
    if int(cv2.__version__.partition(".")[0]) < 5:
        remedy = "pip install --upgrade 'trigpoint[edge]'"
        return Check("edge", "error", f"OpenCV {cv2.__version__} is too old", remedy)
    return Check("edge", "ok", f"OpenCV {cv2.__version__}")


def _cameras() -> list[Check]:
    devices = sorted(Path("/dev").glob("video[0-9]*"))
    if not devices:
        remedy = "plug one in; network cameras and files need none"
        return [Check("cameras", "warning", "this machine has no camera (/dev/video*)", remedy)]
    return [_access(device) for device in devices]


def _access(device: Path) -> Check:
    if os.access(device, os.R_OK | os.W_OK):
        return Check("camera", "ok", f"{device} can be opened by this user")
    remedy = "add this user to the group «video» (usermod -aG video) and log in again"
    return Check("camera", "error", f"{device} may not be opened by this user", remedy)
