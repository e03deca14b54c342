"""Whether a map is learnt or held as it is, and the command that switches.

A map that is to be held is solved to the end first; then it stays, its solver ends, and nothing is
stored any more.
"""

import json
from enum import StrEnum

import msgspec

from trigpoint.base.errors import InputError, OperationError
from trigpoint.fusion.fixed.network import FixedNetwork


class MapState(StrEnum):
    """What becomes of the map, as the diagnostics say it."""

    LEARNT = "learnt"
    SETTLING = "being fixed"
    FIXED = "fixed"


class _Wish(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    learn: bool


class Holding:
    """`learns`: whether the map is wanted to be learnt; `fixed`: the network that is held, None
    while it is learnt or solved for the last time, which `is_asked` says. Not thread-safe."""

    def __init__(self, fixed: FixedNetwork | None, *, learns: bool) -> None:
        self.fixed, self.learns = fixed, learns
        self.is_asked = False

    @property
    def state(self) -> MapState:
        """What becomes of the map now."""
        if self.fixed is not None:
            return MapState.FIXED
        return MapState.LEARNT if self.learns else MapState.SETTLING

    @property
    def is_to_learn_again(self) -> bool:
        """Whether a fixed map is to be learnt from now on."""
        return self.learns and self.fixed is not None

    @property
    def is_to_be_held(self) -> bool:
        """Whether a map that is learnt is to be held."""
        return not self.learns and self.fixed is None

    def want(self, *, learns: bool) -> None:
        """Ask for a map that is learnt, or held."""
        self.learns, self.is_asked = learns, False

    def hold(self, fixed: FixedNetwork | None) -> None:
        """Hold a network; None: learn again."""
        self.fixed, self.is_asked = fixed, False

    def answered(self, request: bytes, *, has_map: bool) -> bytes:
        """Take a request (`wish_of`) and answer it. Raises InputError where it is none,
        OperationError where there is no map to hold."""
        wish = wish_of(request)
        if wish is False and self.learns and not has_map:
            raise OperationError("no camera is located yet; there is no map to hold fixed")
        if wish is not None and wish != self.learns:
            self.want(learns=wish)
        return json.dumps({"learn": self.learns, "map": self.state}).encode()

    def check_is_learnt(self, command: str) -> None:
        """Raise OperationError where the map is not given up; `command`: the key that learns it
        again."""
        if self.state is not MapState.LEARNT:
            raise OperationError(
                f"the map is {self.state} (learn = false) and is not given up; send "
                f'{{"learn": true}} to {command} first'
            )


def wish_of(request: bytes) -> bool | None:
    """What a request asks for; None where it only asks how it is. Raises InputError where it is
    none."""
    if not request:
        return None
    try:
        return msgspec.json.decode(request, type=_Wish).learn
    except msgspec.DecodeError as reason:
        raise InputError(
            f'fusion/learn: no request ({reason}); send {{"learn": false}} or {{"learn": true}}'
        ) from None
