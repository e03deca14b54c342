"""The file of a map's last solution, from which corrections go on at once after a restart.

The checkpoint alone makes the map (decisions/0602): this file only bridges the time until it is
solved again, and where it does not fit what is there, corrections begin then.
"""

import hashlib
import logging
from collections import deque
from pathlib import Path
from threading import Event, Lock
from typing import Any
from uuid import UUID

import msgspec
import numpy as np

from trigpoint import __version__
from trigpoint.geometry.rotation import Array
from trigpoint.node.watchdog import Pulse

from .checked_file import checked_body, save_checked
from .live.solver_messages import Shares, Solved
from .model.dataset import Conclusions
from .model.inputs import Inputs
from .model.known_cameras import Creep
from .model.problem import Layout, State
from .pipeline import Pipeline
from .solver.filter import Filter
from .solver.gaussian import Gaussian

SOLUTION = "solution.bin"
"""Its name in the folder of a map."""
_MAGIC = b"trigpoint-solution/3\n"  # another number with each change of what is in it
_LENGTH = 8  # bytes of the document's, which is followed by the covariance
_LOOK_S = 1.0

_log = logging.getLogger(__name__)


class _Document(msgspec.Struct):
    """`inputs`: a digest of what the solution rests on beside messages, the program too."""

    inputs: bytes
    map_id: str
    until_ns: int
    state: State
    stamps_ns: dict[str, int]
    layout: Layout
    mean: Array
    shares: Shares
    conclusions: Conclusions
    located: tuple[str, ...]


class SolutionFile:
    """The last solution of the maps in a folder, one after the other: it is kept by one thread, and
    written by another, since that of a hundred cameras has 18 MB."""

    def __init__(self, folder: Path, inputs: Inputs) -> None:
        self._path, self._inputs = folder / SOLUTION, _digest(inputs)
        self._creep = Creep.of_all(inputs.site.cameras)
        self._kept: Solved | None = None
        self._lock = Lock()
        self._unwritten = deque[tuple[Solved, UUID | None]](maxlen=1)

    def keep(self, pipeline: Pipeline) -> None:
        """Have the last solution written where it is a new one."""
        solution = pipeline.reports.solution
        if solution is not None and solution is not self._kept:
            self._kept = solution
            self._unwritten.append((solution, pipeline.map_id))

    def run(self, pulse: Pulse, stopping: Event) -> None:
        """Write what is kept until a stop, on a thread of its own, and beat the pulse."""
        while not stopping.wait(_LOOK_S):
            pulse.beat()
            self.write()
        self.write()

    def write(self) -> None:
        """Replace the file by what was kept last, where that is not done."""
        with self._lock:
            while self._unwritten:
                self._write(*self._unwritten.popleft())

    def _write(self, solution: Solved, map_id: UUID | None) -> None:
        document = self._document(solution, map_id)
        packed = msgspec.msgpack.encode(document, enc_hook=_plain)
        covariance = np.ascontiguousarray(solution.known.known.covariance).data.cast("B")
        # The covariance is not copied, and written without the interpreter's lock.
        body = len(packed).to_bytes(_LENGTH, "little"), packed, covariance
        try:
            save_checked(self._path, _MAGIC, *body, is_synced=False)
        except OSError as reason:
            _log.warning(
                "%s: not written (%s); started again, fusion makes corrections once all is solved",
                self._path,
                reason.strerror,
            )

    def forget(self) -> None:
        """Remove the file: the map goes on otherwise than from it."""
        with self._lock:
            self._unwritten.clear()
            try:
                self._path.unlink(missing_ok=True)
            except OSError as reason:
                _log.warning("%s: not removed (%s)", self._path, reason.strerror)

    def load(self, map_id: UUID | None, now_ns: int) -> Solved | None:
        """The last solution of this map, with its cameras as uncertain as they may have crept until
        now; None where there is none, or where it rests on another site file, on other targets or
        lenses, or is damaged or another version's."""
        try:
            body = checked_body(self._path.read_bytes(), _MAGIC)
            if body is None:
                raise ValueError("it is damaged, or another version's")
            end = _LENGTH + int.from_bytes(body[:_LENGTH], "little")
            packed = memoryview(body)[_LENGTH:end]
            document = msgspec.msgpack.decode(packed, type=_Document, dec_hook=_array)
            size = len(document.mean)
            covariance = np.frombuffer(body, offset=end).reshape(size, size).copy()
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as reason:  # msgspec's are ValueErrors
            _log.warning("%s: not used (%s)", self._path, reason)
            return None
        if document.map_id != str(map_id):
            return None
        if document.inputs != self._inputs:
            _log.info("%s: not used, since the site or the program has changed", self._path)
            return None
        return self._solution(document, covariance, now_ns)

    def _document(self, solved: Solved, map_id: UUID | None) -> _Document:
        known = solved.known
        return _Document(
            inputs=self._inputs,
            map_id=str(map_id),
            until_ns=solved.until_ns,
            state=known.state,
            stamps_ns=known.stamps_ns,
            layout=known.layout,
            mean=known.known.mean,
            shares=solved.shares,
            conclusions=solved.conclusions,
            located=solved.located,
        )

    def _solution(self, document: _Document, covariance: Array, now_ns: int) -> Solved:
        source = Gaussian.of(document.mean, covariance)
        known = Filter(document.state, document.stamps_ns, document.layout, source)
        crept = {
            camera: self._creep[camera].covariance(now_ns - document.until_ns)
            for camera in known.layout.pose.keys() & self._creep.keys()
        }
        return Solved(
            0,
            known.spread(crept),
            document.shares,
            document.conclusions,
            document.located,
            document.until_ns,
        )


def _digest(inputs: Inputs) -> bytes:
    site, known = inputs.site, inputs.known
    values = [(*what, value) for what, value in sorted(known.values.items())]
    parts = (
        *(site.cameras, site.robots, site.fusion, site.default_target),
        *(inputs.targets, inputs.lenses, known.poses, known.information, known.until_ns),
        *(known.faces, values, __version__),
    )
    return hashlib.sha256(msgspec.msgpack.encode(parts, enc_hook=_plain)).digest()


def _plain(value: Any) -> object:
    """What msgpack does not have, by what it has."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise NotImplementedError(f"no form for {type(value)}")


def _array(_type: Any, plain: Any) -> np.ndarray:
    """An array of a document; ValueError where it is none."""
    kind, shape, data = plain
    return np.frombuffer(data, kind).reshape(shape).copy()
