"""Cameras whose pictures fit far better by another lens than by the one that is given.

A lens that is not the camera's has the faces in one picture contradict each other, and what does
not fit is rejected until the rest fits, at another place. So the camera's pictures are explained as
they are, and with its lens as an unknown; by the one score, the likeliest is what happened.
"""

from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.geometry import CameraModel

from .budget import Budget
from .memory import Memory
from .other_odometry import CLEAR, MOST_REJECTED, as_it_came, world_of

# Of the budget for the session's length.
_SHARE = 0.1
# Of the χ² that corners come to by chance: priors of poses and of wrong sightings add about as much
# in a few pictures, and a wrong sighting that is left in some hundred times as much.
_MOST_MISFIT = 4.0


def other_lenses(data: DataSet) -> dict[str, CameraModel]:
    """Camera -> the lens that explains far more than the given one. `data`: after its last
    explanation; where that rejected little of a camera, its lens is not questioned."""
    asked = [
        name
        for name, camera in data.site.cameras.items()
        if name in data.lenses and not camera.estimates_intrinsics and _rejects(data, name)
    ]
    found = {name: _other(data, name, _SHARE / len(asked)) for name in asked}
    return {name: lens for name, lens in found.items() if lens is not None}


def _rejects(data: DataSet, camera: str) -> bool:
    """Whether more of what it saw contradicts the rest than are only wrong sightings."""
    every = [e.observation for place in data.places_of(camera) for e in data.of_camera(place)]
    seen = sum(len(observation.views) for observation in every)
    return seen - sum(observation.used_views for observation in every) > MOST_REJECTED * seen


def _other(data: DataSet, camera: str, share: float) -> CameraModel | None:
    """The lens that explains a camera's pictures, and far better; `share`: of the budget."""
    places = data.places_of(camera)
    mine = [as_it_came(data, e.observation) for place in places for e in data.of_camera(place)]
    mine.sort(key=lambda observation: observation.stamp_ns)
    draft = data.draft()
    config = replace(draft.site.cameras[camera], intrinsics="estimate")
    site = replace(draft.site, cameras={**draft.site.cameras, camera: config})
    told, free = (
        world_of(each, mine, Memory(Budget.of(data.tracks.values(), share=share / 2)))
        for each in (draft, replace(draft, site=site))
    )
    if told.budget.is_spent or free.budget.is_spent:
        return None
    fits = _MOST_MISFIT * 2 * sum(observation.corner_count for observation in mine)
    if free.score >= min(fits, told.score - CLEAR):
        return None
    modes = [visit.modes[0] for visit in free.visits if visit.modes]
    return max(modes, key=lambda mode: mode.right_pictures).camera.lens if modes else None
