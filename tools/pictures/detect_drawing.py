"""Draws sightings into pictures for people."""

import cv2
import numpy as np

from trigpoint.contract.messages import FaceSighting

_COLOURS = ((40, 160, 255), (80, 220, 80), (255, 140, 60), (220, 80, 220), (60, 220, 220))
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_READABLE_WIDTH = 1200


def draw_faces(picture: np.ndarray, faces: tuple[FaceSighting, ...]) -> np.ndarray:
    """The grey picture as BGR, enlarged if small, with corners, their ids and the face's name near
    corner 0."""
    scale = max(1, round(_READABLE_WIDTH / picture.shape[1]))
    large = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    canvas = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    for number, face in enumerate(faces):
        _draw_face(canvas, face, scale, _COLOURS[number % len(_COLOURS)])
    return canvas


def _draw_face(
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
