"""The `sim://` source of pictures: a simulated camera in real time, for the edge agent."""

import threading
from collections.abc import Iterator
from urllib.parse import parse_qs, urlsplit

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.base.errors import FrameError, InputError
from trigpoint.edge.sources.frames import Frame
from trigpoint.geometry import CameraModel
from trigpoint.site.config import CameraConfig

from .drawing.rendering import CameraRenderer
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
        name, options = _address(url)
        self._clock = clock
        self._epoch_ns = _whole_number(url, "epoch_ns", options.get("epoch_ns", clock.now_ns()))
        seed = _whole_number(url, "seed", options.get("seed", 0))
        try:
            world = load_world(options.get("world", "lab"), seed=seed, target=options.get("target"))
            self._camera = world.camera(name)
        except InputError as reason:
            raise FrameError(f"source {url}: {reason}") from None
        _check_size(url, self._camera.model, camera)
        self._renderer = CameraRenderer(world, name)
        self._skipped = 0

    @property
    def intrinsics(self) -> CameraModel | None:
        return self._camera.model

    @property
    def skipped(self) -> int:
        """How many pictures were due but not handed out, since the taker was slow."""
        return self._skipped

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Pictures until `stopping` is set; made on the taker's thread, each before it is due where
        the taker is in time, so that what drawing takes does not count as the camera's delay."""
        due = max(0, self._newest() + 1)
        picture = self._renderer.picture(due)
        while self._wait_for(due, stopping):
            yield Frame(picture, self._captured_ns(due))
            following = max(due + 1, self._newest())
            self._skipped += following - due - 1
            due, picture = following, self._renderer.picture(following)

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
        """The middle of a picture's exposure, Unix time."""
        return self._epoch_ns + to_ns(float(self._camera.time_of(index)))


def _address(url: str) -> tuple[str, dict[str, str]]:
    """The camera's name, and what the world is."""
    parts = urlsplit(url)
    options = parse_qs(parts.query, keep_blank_values=True)
    unknown = next((key for key in options if key not in _KEYS), None)
    if unknown is not None:
        raise FrameError(f"source {url}: unknown key «{unknown}»; known are {', '.join(_KEYS)}")
    if not parts.netloc:
        raise FrameError(f"source {url}: names no camera; write sim://c1?world=lab&seed=1")
    return parts.netloc, {key: values[-1] for key, values in options.items()}


def _whole_number(url: str, key: str, text: str | int) -> int:
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
