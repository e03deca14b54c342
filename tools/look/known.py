"""Which lens is known of the camera, by whom, and how well it fits what is seen."""

from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.lens.calibration_fit import place
from trigpoint.edge.lens.calibration_views import views_of
from trigpoint.geometry import CameraModel
from trigpoint.site.target import Target


class KnownLens:
    """For one thread. `given`: the lens that the user gave."""

    def __init__(self, target: Target, given: CameraModel | None) -> None:
        self._target, self._camera = target, given
        self._by = "given" if given is not None else ""

    def hear(self, own: CameraModel | None) -> None:
        """Take the source's own lens where none was given."""
        if self._camera is None and own is not None:
            self._camera, self._by = own, "by the source"

    def take(self, camera: CameraModel, where: str) -> None:
        """Take the one that was worked out, and written there."""
        self._camera, self._by = camera, f"in {where}"

    def words(self, seen: FaceSighting | None) -> str:
        """Whether it is known, and by how much it misses the corners that are seen."""
        if self._camera is None:
            return "not known yet"
        views = [] if seen is None else views_of("", [seen], [self._target])
        placed = place(self._camera, views[0]) if views else None
        fits = f"; it fits this picture to {placed.rms_px:.2f} px a corner" if placed else ""
        return f"known, {self._by}{fits}"
