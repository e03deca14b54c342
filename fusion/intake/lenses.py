"""The cameras' lenses, as files give them or cameras announce them; sightings wait for theirs."""

from collections.abc import Container

from trigpoint.contract.messages import CameraInfo, Sightings
from trigpoint.fusion.model.dataset import DataSet

from .message_intake import Intake

# The most sightings kept of cameras whose intrinsics have not come yet.
_MOST_EARLY = 4096


class Lenses:
    """Notes lenses in the data set, and hands on the sightings of cameras that have one. `given`:
    cameras whose lenses files give, whatever they announce."""

    def __init__(self, data: DataSet, intake: Intake, given: Container[str]) -> None:
        self._data, self._intake, self._left_out = data, intake, intake.left_out
        self._given = given
        self._early: list[tuple[str, Sightings]] = []

    @property
    def waiting(self) -> int:
        """How many messages with sightings wait for a lens."""
        return len(self._early)

    def announce(self, camera: str, message: CameraInfo) -> bool:
        """Take what a camera says of its lens; whether that is the first."""
        if camera in self._given:
            return False
        if camera in self._data.lenses:
            if self._data.lenses[camera] != message.camera:
                self._left_out.add(
                    "changed_intrinsics",
                    f"camera {camera} announces other intrinsics than this map began with, which "
                    "are not taken over; start a new map with fusion/reset",
                    of=camera,
                )
            return False
        try:
            message.camera.check()
        except ValueError as reason:
            text = f"camera {camera}: {reason}"
            self._left_out.add("impossible_intrinsics", text, of=camera)
            return False
        self._data.lenses[camera] = message.camera
        early, self._early = self._early, []
        for node, sightings in early:
            self.hand_on(node, sightings)
        return True

    def hand_on(self, camera: str, message: Sightings) -> bool:
        """Have sightings taken in, now or once there is a lens; whether they may add to the map."""
        config = self._data.site.cameras[camera]
        if camera not in self._data.lenses and config.estimates_intrinsics:
            self._data.lenses[camera] = config.nominal()
        lens = self._data.lenses.get(camera)
        if lens is not None:
            return self._intake.add(camera, message, lens)
        if len(self._early) < _MOST_EARLY:
            self._early.append((camera, message))
            return True
        self._left_out.add("without_intrinsics")
        return False
