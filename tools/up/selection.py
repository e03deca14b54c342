"""Which parts of a site belong to this machine.

On a secured site the keys on this machine say so. Otherwise a part with a device belongs where the
device is, and what could run anywhere (fusion, the recorder, the page, cameras and robots on the
network) where the site's bus begins: on the machine that does not connect to another.
"""

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from msgspec import Struct

from trigpoint.base.errors import InputError
from trigpoint.base.words import nearest
from trigpoint.contract.access import Kind
from trigpoint.site.config import Site, is_loopback


class PartKind(StrEnum):
    """What may be left out by name."""

    CAMERA = "camera"
    ROBOT = "robot"
    FUSION = "fusion"
    RECORDER = "recorder"
    BOARD = "board"


class Choice(Struct, frozen=True):
    """What the command line says: cameras and robots by name, none for those that are here; kinds
    that are left out."""

    cameras: tuple[str, ...] = ()
    robots: tuple[str, ...] = ()
    without: frozenset[PartKind] = frozenset()

    @classmethod
    def of(cls, site: Site, cameras: list[str], robots: list[str], without: list[str]) -> "Choice":
        """The choice in a site; raises InputError or ConfigError for a name that there is not."""
        for camera in cameras:
            site.camera(camera)
        for robot in robots:
            site.robot(robot)
        for word in without:
            if word not in list(PartKind):
                raise InputError(
                    f"--without is «{word}»{nearest(word, list(PartKind))} "
                    f"(one of {', '.join(PartKind)})"
                )
        return cls(tuple(cameras), tuple(robots), frozenset(map(PartKind, without)))


class Selection(Struct, frozen=True):
    """The parts of this machine; `left_out`: what is not here and why, in words."""

    cameras: tuple[str, ...]
    robots: tuple[str, ...]
    has_fusion: bool
    has_recorder: bool
    has_board: bool
    left_out: tuple[str, ...]

    @property
    def is_empty(self) -> bool:
        """Whether nothing of the site itself runs here; the page alone is no part of it."""
        return not (self.cameras or self.robots or self.has_fusion or self.has_recorder)


def selected(
    site: Site, choice: Choice, *, exists: Callable[[Path], bool] = Path.exists
) -> Selection:
    """The parts that belong here. `exists`: whether a device, a file or a key is on this
    machine."""
    look = _Look(site, exists)
    left_out: list[str] = []

    def here(kind: PartKind, names: list[str], chosen: tuple[str, ...]) -> tuple[str, ...]:
        if kind in choice.without:
            return ()
        reasons = {} if chosen else {name: look.reason_against(kind, name) for name in names}
        left_out.extend(f"{kind} {name}: {reason}" for name, reason in reasons.items() if reason)
        return chosen or tuple(name for name in names if not reasons[name])

    return Selection(
        cameras=here(PartKind.CAMERA, list(site.cameras), choice.cameras),
        robots=here(PartKind.ROBOT, list(site.robots), choice.robots),
        has_fusion=bool(here(PartKind.FUSION, ["fusion"], ())),
        has_recorder=bool(here(PartKind.RECORDER, ["main"], ())),
        has_board=bool(here(PartKind.BOARD, ["board"], ())),
        left_out=tuple(left_out),
    )


class _Look:
    def __init__(self, site: Site, exists: Callable[[Path], bool]) -> None:
        self._site, self._exists = site, exists
        self._connects = [one for one in site.bus.connect if not is_loopback(one)]

    def reason_against(self, kind: PartKind, name: str) -> str:
        """Why a part does not belong here, "" where it does."""
        if kind is PartKind.FUSION and not self._site.robots:
            return "the site has no robot, without which nothing is located"
        if self._site.bus.tls is not None and self._connects and kind is not PartKind.BOARD:
            return self._without_key(Kind(kind.value), name)
        if kind is PartKind.CAMERA:
            return self._without_camera(name)
        if kind is PartKind.ROBOT:
            return self._without_robot(name)
        return self._without_server()

    def _without_key(self, kind: Kind, name: str) -> str:
        assert self._site.bus.tls is not None
        key = self._site.path(self._site.bus.tls.directory) / f"{kind}-{name}.key"
        return "" if self._exists(key) else f"no key {key.name} here"

    def _without_camera(self, name: str) -> str:
        return self._without_file(self._site.cameras[name].file)

    def _without_robot(self, name: str) -> str:
        port = self._site.robots[name].port
        return self._without_file(None if port is None or "://" in port else port)

    def _without_file(self, name: str | None) -> str:
        if name is None:
            return self._without_server()
        path = self._site.path(name)
        return "" if self._exists(path) else f"no {path} here"

    def _without_server(self) -> str:
        if self._connects:
            return f"it runs where {self._connects[0]} is"
        return ""
