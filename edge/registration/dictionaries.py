"""OpenCV's dictionaries of markers, by name."""

import cv2

from trigpoint.errors import TargetError


def predefined_dictionary(name: str) -> cv2.aruco.Dictionary:
    """One of OpenCV's marker dictionaries; raise TargetError that lists them."""
    known = [known for known in dir(cv2.aruco) if known.startswith("DICT_")]
    if name not in known:
        raise TargetError(f"the dictionary «{name}» is not known; use one of {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
