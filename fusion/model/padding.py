"""Builds the corners of many observations at once, as tables padded to one width."""

import numpy as np

from trigpoint.site.target import Target

from .observations import Observation, Points, base_from_faces, joined


def padded_points(observations: list[Observation], target: Target) -> Points:
    """`points_of` of observations (n) of one robot, padded to the widest of them: (n, K, 3),
    (n, K), (n, K, 2) and (n, K), all of them 0 where an observation has no more corners."""
    views = [view for observation in observations for view in observation.views]
    readings = [reading for observation in observations for reading in observation.chosen or ()]
    assert len(readings) == len(views)
    sizes = np.array([len(view.corners) for view in views])
    faces = np.repeat([reading.face for reading in readings], sizes)
    is_turned = np.repeat([reading.is_turned for reading in readings], sizes)
    corners = np.concatenate([view.corners for view in views])
    counts = np.array([face.corner_count for face in target.faces])
    ids = np.where(is_turned, counts[faces] - 1 - corners, corners)
    first = np.cumsum(counts) - counts
    weights = np.repeat([1 / view.sigma for view in views], sizes)
    weights[np.concatenate([flags for each in observations for flags in each.wild])] = 0.0
    widths = np.array([observation.corner_count for observation in observations])
    rows = np.repeat(np.arange(len(widths)), widths)
    at = rows, np.arange(len(rows)) - (np.cumsum(widths) - widths)[rows]
    shape = (len(widths), int(widths.max()))
    points = Points(
        np.zeros((*shape, 3)), np.zeros(shape, int), np.zeros((*shape, 2)), np.zeros(shape)
    )
    in_face = np.concatenate([f.corners for f in target.faces])[first[faces] + ids]
    sweep = joined(views)
    if sweep is not None:
        poses = base_from_faces(target)[faces]
        shift = sweep.shift((poses.rotation @ in_face[..., None])[..., 0] + poses.translation)
        in_face = in_face + (shift[:, None] @ poses.rotation)[:, 0]
    points.face_points[at] = in_face
    points.faces[at] = faces
    points.pixels[at] = np.concatenate([view.pixels for view in views])
    points.weights[at] = weights
    return points
