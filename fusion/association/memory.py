"""What is kept from one explanation of a growing session to the next."""

from collections.abc import Iterable
from typing import Generic, TypeVar

from trigpoint.fusion.model.observations import Observation, View
from trigpoint.geometry import CameraModel

from .budget import Budget
from .linear import Linear
from .mode import VisitModes
from .noise import Noise
from .sightings import Alone
from .trail import Trail

_Value = TypeVar("_Value")


class Kept(Generic[_Value]):
    """What was found, by key, from one search to the next; what one did not ask for is dropped."""

    def __init__(self) -> None:
        self._before: dict[tuple[object, ...], _Value] = {}
        self._used: dict[tuple[object, ...], _Value] = {}

    def get(self, key: tuple[object, ...]) -> _Value | None:
        """What is cached by this key, which is thereby marked as used; None where nothing is."""
        if key not in self._used and key in self._before:
            self._used[key] = self._before[key]
        return self._used.get(key)

    def put(self, key: tuple[object, ...], found: _Value) -> _Value:
        self._used[key] = found
        return found

    def forget_unused(self) -> None:
        """Drop what was not asked for since the last call."""
        self._before, self._used = self._used, {}


class Memory:
    """Caches what was found of visits from one search to the next, since most visits of a growing
    session do not change. Not thread-safe.

    `budget`: for what is not cached; `modes`: of visits; `alone`: by view and lens, what each view
    says by itself; `lenses`: by camera whose lens is estimated, the lens by its most informative
    visit so far; `shown`: what visits show of the noise, and `noise`: what was learnt from these;
    `trails`: what searches kept on their way.
    """

    def __init__(
        self,
        budget: Budget | None = None,
        alone: dict[tuple[View, CameraModel], Alone] | None = None,
    ) -> None:
        self.budget = budget if budget is not None else Budget()
        self.modes = Kept[VisitModes]()
        self.shown = Kept[Linear]()
        self.noise = Kept[tuple[Noise | None, ...]]()
        self.trails: list[Trail] = []
        self.alone = alone if alone is not None else {}
        self.lenses: dict[str, CameraModel] = {}
        self._told_by: dict[str, int] = {}
        self._scattering: dict[tuple[object, ...], tuple[Observation, Observation]] = {}

    def scattering(self, observation: Observation, factor: float) -> Observation:
        """`Observation.scattering`, cached, so that its views stay the same objects: cache keys."""
        if factor == 1.0:
            return observation
        key = observation.camera, observation.robot, observation.stamp_ns, factor
        known = self._scattering.get(key)
        if known is None or known[0] is not observation:
            known = self._scattering[key] = observation, observation.scattering(factor)
        return known[1]

    def learn_lens(self, found: VisitModes) -> None:
        """Take the lens of a visit that has more chosen pictures than any before: a lens that is
        only a little better is not worth recomputing everything."""
        camera, pictures = found.visit.camera, len(found.visit.chosen)
        if found.modes and pictures > self._told_by.get(camera, 0):
            self.lenses[camera] = found.modes[0].camera.lens
            self._told_by[camera] = pictures

    def keep(self, observations: Iterable[Observation]) -> None:
        """Drop what is of other observations than these, and where the search has been."""
        self.trails = []
        kept = {(o.camera, o.robot, o.stamp_ns): o for o in observations}
        self._scattering = {k: found for k, found in self._scattering.items() if k[:3] in kept}
        scattered = [found for _, found in self._scattering.values()]
        views = {view for o in (*kept.values(), *scattered) for view in o.views}
        self.alone = {key: found for key, found in self.alone.items() if key[0] in views}

    def forget_unused(self) -> None:
        """Drop what was not asked for since the last call."""
        for kept in (self.modes, self.shown, self.noise):
            kept.forget_unused()
