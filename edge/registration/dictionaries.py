"""OpenCV's dictionaries of markers, by name."""

from functools import cache

import cv2

from trigpoint.base.errors import TargetError
from trigpoint.base.words import nearest
from trigpoint.site.target import Face


@cache
def predefined_dictionary(name: str) -> cv2.aruco.Dictionary:
    """One of OpenCV's marker dictionaries, shared and never written to; raise TargetError that
    lists them."""
    known = [known for known in dir(cv2.aruco) if known.startswith("DICT_")]
    if name not in known:
        raise TargetError(
            f"the dictionary «{name}» is not known{nearest(name.upper(), known)}; use one of "
            f"{', '.join(known)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def dictionary_of(face: Face) -> cv2.aruco.Dictionary:
    """The dictionary of a marked face; raise TargetError where it is unknown or has not all of the
    face's markers."""
    dictionary = predefined_dictionary(face.dictionary or "")
    last, size = face.first_marker + face.marker_count - 1, len(dictionary.bytesList)
    if last >= size:
        raise TargetError(
            f"face {face.id} needs markers {face.first_marker} to {last}, but {face.dictionary} "
            f"has {size}; use a larger dictionary"
        )
    return dictionary
