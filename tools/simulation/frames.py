"""The `sim://` source of pictures: a simulated camera in real time, for the edge agent."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.base.errors import FrameError, InputError
from trigpoint.edge.sources.frames import Frame
from trigpoint.geometry import CameraModel
from trigpoint.site.config import CameraConfig

from .drawing.rendering import CameraRenderer
from .motion.actors import SimulatedCamera
from .world import load_world

_KEYS = ("world", "seed", "epoch_ns", "target")


class SimulatedFrames:
    """`sim://c1?world=lab&seed=1&epoch_ns=…[&target=checkerboard]`.

    World time 0 is at `epoch_ns`, Unix time in nanoseconds; without it, at the moment of opening.
    Pictures come on the world's grid of time, each as soon as its exposure is over, so a source
    that is opened again goes on where the world is. After the world's end the robots stand still.
    """

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        """Raises FrameError where the URL names nothing that is there."""
        address = _address(url)
        self._clock = clock
        self._epoch_ns = clock.now_ns() if address.epoch_ns is None else address.epoch_ns
        try:
            world = load_world(address.world, seed=address.seed, target=address.target)
            self._camera = world.camera(address.camera)
        except InputError as reason:
            raise FrameError(f"source {url}: {reason}") from None
        _check_size(url, self._camera.model, camera)
        self._renderer = CameraRenderer(world, address.camera)
        self._skipped = 0

    @property
    def intrinsics(self) -> CameraModel | None:
        """The simulated lens."""
        return self._camera.model

    @property
    def skipped(self) -> int:
        """How many pictures were due but not handed out, since the taker was slow."""
        return self._skipped

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Pictures until `stopping` is set; made on the taker's thread."""
        due = max(0, self._newest() + 1)
        while self._wait_for(due, stopping):
            newest = max(due, self._newest())
            self._skipped += newest - due
            yield Frame(self._renderer.picture(newest), self._captured_ns(newest))
            due = newest + 1

    def close(self) -> None:
        """Nothing is held open."""

    def _newest(self) -> int:
        """The last picture whose exposure is over; negative before the first."""
        ready_s = to_seconds(self._clock.now_ns() - self._epoch_ns) - self._camera.open_s / 2
        return int((ready_s - self._camera.phase) * self._camera.rate // 1)

    def _wait_for(self, index: int, stopping: threading.Event) -> bool:
        """Wait for the end of a picture's exposure; False where `stopping` came first."""
        ready_ns = self._captured_ns(index) + to_ns(self._camera.open_s / 2)
        while not stopping.is_set():
            left_ns = ready_ns - self._clock.now_ns()
            if left_ns <= 0:
                return True
            self._clock.wait(stopping, to_seconds(left_ns))
        return False

    def _captured_ns(self, index: int) -> int:
        return captured_ns(self._camera, index, self._epoch_ns)


def captured_ns(camera: SimulatedCamera, index: int, epoch_ns: int) -> int:
    """The middle of a picture's exposure, Unix time."""
    return epoch_ns + to_ns(float(camera.time_of(index)))


@dataclass(frozen=True, slots=True)
class _Address:
    camera: str
    world: str
    seed: int
    epoch_ns: int | None
    target: str | None


def _address(url: str) -> _Address:
    parts = urlsplit(url)
    options = parse_qs(parts.query, keep_blank_values=True)
    unknown = next((key for key in options if key not in _KEYS), None)
    if unknown is not None:
        raise FrameError(f"source {url}: unknown key «{unknown}»; known are {', '.join(_KEYS)}")
    if not parts.netloc:
        raise FrameError(f"source {url}: names no camera; write sim://c1?world=lab&seed=1")
    values = {key: value[-1] for key, value in options.items()}
    return _Address(
        camera=parts.netloc,
        world=values.get("world", "lab"),
        seed=_whole_number(url, "seed", values.get("seed", "0")),
        epoch_ns=_whole_number(url, "epoch_ns", values["epoch_ns"])
        if "epoch_ns" in values
        else None,
        target=values.get("target"),
    )


def _whole_number(url: str, key: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise FrameError(f"source {url}: {key} is «{text}»; it must be a whole number") from None


def _check_size(url: str, model: CameraModel, camera: CameraConfig) -> None:
    if (camera.width, camera.height) != (model.width, model.height):
        raise FrameError(
            f"source {url} gives pictures of {model.width} × {model.height}, but the site file "
            f"says {camera.width} × {camera.height}; correct width and height"
        )
