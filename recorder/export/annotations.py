"""Sightings as foxglove_msgs/msg/ImageAnnotations, which Foxglove draws over a picture."""

from typing import Any

import numpy as np

from trigpoint.contract.cdr_ros import Builder, register, store
from trigpoint.contract.messages import Sightings

ANNOTATIONS = "foxglove_msgs/msg/ImageAnnotations"
_POINTS = 1
_GREEN, _YELLOW = (0.35, 1.0, 0.45, 1.0), (1.0, 0.85, 0.3, 1.0)
_CLEAR, _PLATE = (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.6)

_DEFINITIONS = {
    "foxglove_msgs/msg/Point2": "float64 x\nfloat64 y\n",
    "foxglove_msgs/msg/Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n",
    "foxglove_msgs/msg/CircleAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nfloat64 diameter\n"
        "float64 thickness\nfoxglove_msgs/Color fill_color\nfoxglove_msgs/Color outline_color\n"
    ),
    "foxglove_msgs/msg/PointsAnnotation": (
        "uint8 UNKNOWN=0\nuint8 POINTS=1\nuint8 LINE_LOOP=2\nuint8 LINE_STRIP=3\n"
        "uint8 LINE_LIST=4\nbuiltin_interfaces/Time timestamp\nuint8 type\n"
        "foxglove_msgs/Point2[] points\nfoxglove_msgs/Color outline_color\n"
        "foxglove_msgs/Color[] outline_colors\nfoxglove_msgs/Color fill_color\n"
        "float64 thickness\n"
    ),
    "foxglove_msgs/msg/TextAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nstring text\n"
        "float64 font_size\nfoxglove_msgs/Color text_color\nfoxglove_msgs/Color background_color\n"
    ),
    ANNOTATIONS: (
        "foxglove_msgs/CircleAnnotation[] circles\nfoxglove_msgs/PointsAnnotation[] points\n"
        "foxglove_msgs/TextAnnotation[] texts\n"
    ),
}


def annotations(sightings: Sightings) -> bytes:
    """The CDR bytes of a picture's sightings as annotations: corners and a name for each face."""
    register(_DEFINITIONS)
    ros = Builder()
    points, texts = [], []
    for face in sightings.faces:
        known = face.face >= 0
        colour = _GREEN if known else _YELLOW
        points.append(_points(ros, sightings.stamp_ns, face.pixels, colour))
        top = face.pixels[int(np.argmin(face.pixels[:, 1]))]
        texts.append(
            ros(
                "foxglove_msgs/TextAnnotation",
                timestamp=_time(ros, sightings.stamp_ns),
                position=_point(ros, top),
                text=f"face {face.face}" if known else "a face",
                font_size=12.0,
                text_color=_colour(ros, colour),
                background_color=_colour(ros, _PLATE),
            )
        )
    message = ros("foxglove_msgs/ImageAnnotations", circles=[], points=points, texts=texts)
    return bytes(store().serialize_cdr(message, ANNOTATIONS))


def prepare() -> None:
    """Make the types known, for their definitions."""
    register(_DEFINITIONS)


def _points(ros: Builder, stamp_ns: int, pixels: np.ndarray, colour: tuple[float, ...]) -> Any:
    return ros(
        "foxglove_msgs/PointsAnnotation",
        timestamp=_time(ros, stamp_ns),
        type=_POINTS,
        points=[_point(ros, pixel) for pixel in pixels],
        outline_color=_colour(ros, colour),
        outline_colors=[],
        fill_color=_colour(ros, _CLEAR),
        thickness=4.0,
    )


def _time(ros: Builder, stamp_ns: int) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return ros("builtin_interfaces/Time", sec=seconds, nanosec=nanoseconds)


def _point(ros: Builder, pixel: np.ndarray) -> Any:
    return ros("foxglove_msgs/Point2", x=float(pixel[0]), y=float(pixel[1]))


def _colour(ros: Builder, colour: tuple[float, ...]) -> Any:
    r, g, b, a = colour
    return ros("foxglove_msgs/Color", r=r, g=g, b=b, a=a)
