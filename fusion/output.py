"""The messages that fusion sends, and what they say to people."""

import math

from msgspec import Struct

from trigpoint.base.words import plus_minus
from trigpoint.contract import topics
from trigpoint.contract.messages import Message, PoseEstimate, Transforms
from trigpoint.contract.topics import Topic
from trigpoint.geometry.uncertainty import position_sigma

from .model.observations import Observation


class Output(Struct, frozen=True):
    """A message to send: `node` is the camera or robot of its key; `observation`: what a correction
    is by."""

    topic: Topic
    node: str
    message: Message
    attachment: bytes = b""
    observation: Observation | None = None


class CameraAccuracy:
    """Which cameras are located, and how well, from what is sent about them.

    `worst_sigma_m`: the largest sigma of a located camera, NaN where none is.
    """

    def __init__(self, cameras: list[str]) -> None:
        self._cameras = cameras
        self._sigmas_m: dict[str, float] = {}
        self.worst_sigma_m = math.nan

    def words_after(self, output: Output) -> str:
        """«c1 ±0.8 cm, c2 not located»; "" where this output is not the one that names all located
        cameras."""
        message = output.message
        if output.topic is topics.CAMERA_POSE and isinstance(message, PoseEstimate):
            self._sigmas_m[output.node] = position_sigma(message.covariance)
        if output.topic is not topics.TF_STATIC or not isinstance(message, Transforms):
            return ""
        located = {one.child.partition("/")[0] for one in message.transforms}
        self.worst_sigma_m = max(
            (self._sigmas_m[name] for name in self._cameras if name in located), default=math.nan
        )
        return ", ".join(self._of(name, is_located=name in located) for name in self._cameras)

    def _of(self, camera: str, *, is_located: bool) -> str:
        if not is_located:
            return f"{camera} not located"
        return f"{camera} {plus_minus(self._sigmas_m[camera])}"
