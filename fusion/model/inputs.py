"""What an estimator is made from, before anything came in."""

from msgspec import Struct, field

from trigpoint.geometry import CameraModel
from trigpoint.site.config import Site
from trigpoint.site.target import Target

from .dataset import DataSet
from .known_cameras import KnownCameras
from .past import Past


class Inputs(Struct, frozen=True):
    """What a pipeline is made from. `lenses`: those known beforehand; the others are announced;
    `past`: of a map that goes on, None where it begins."""

    site: Site
    targets: dict[str, Target]
    lenses: dict[str, CameraModel] = field(default_factory=dict)
    known: KnownCameras = field(default_factory=KnownCameras.none)
    past: Past | None = None

    def data_set(self) -> DataSet:
        """What is known beforehand, and nothing else yet."""
        past = self.past
        if past is None:
            return DataSet(self.site, self.targets, dict(self.lenses), self.known)
        lenses = {**past.lenses, **self.lenses}
        return DataSet(self.site, self.targets, lenses, past.known, past=past)
