"""Sightings that are wrong: displaced, with wild corners, or of a face that is named wrongly."""

from dataclasses import replace

import numpy as np

from trigpoint.contract.messages import FaceSighting
from trigpoint.site.target import Target

from .disturbance import Disturbance
from .world import Shown


def disturbed_sighting(
    shown: Shown, target: Target, disturbance: Disturbance, random: np.random.Generator
) -> Shown:
    """What becomes of a sighting under a disturbance. `target`: the robot's."""
    sighting, is_good = shown.sighting, shown.is_good.copy()
    count = len(sighting.corners)
    # Drawn in any case, so that one share does not move what another one hits.
    chances, direction = random.random(2), _directions(1, random)
    wild, sizes = random.random(count), random.random(count) * _directions(count, random).T
    if chances[0] < disturbance.displaced_share:
        pixels = sighting.pixels + disturbance.displaced_px * direction
        sighting = _with_pixels(sighting, pixels)
        is_good[:] = False
    if np.any(hit := wild < disturbance.wild_share):
        pixels = sighting.pixels + disturbance.wild_px * sizes.T * hit[:, None]
        sighting = _with_pixels(sighting, pixels)
        is_good &= ~hit
    others = [face.id for face in target.faces if face.id != sighting.face]
    name = int(random.choice(others)) if others else sighting.face
    if sighting.face >= 0 and chances[1] < disturbance.misnamed_share:
        sighting = replace(sighting, face=name)
    return replace(shown, sighting=sighting, is_good=is_good)


def _directions(count: int, random: np.random.Generator) -> np.ndarray:
    """Unit vectors, (count, 2)."""
    angle = random.uniform(0.0, 2 * np.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _with_pixels(sighting: FaceSighting, pixels: np.ndarray) -> FaceSighting:
    return replace(sighting, pixels=pixels.astype(np.float32))
