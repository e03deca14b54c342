"""`[recorder]`."""

from typing import Literal

from msgspec import Struct

from .number_types import NotNegative, Positive

_LEAST_BUDGET = 1e8


class RecorderConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The recording; sizes in bytes, times in seconds."""

    directory: str = "sessions"
    pictures: bool = False
    keys: tuple[str, ...] = ()
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    synchronise: Positive = 5.0
    split_bytes: NotNegative = 0.0
    split_time: NotNegative = 0.0
    daily: bool = False
    minimum_free: NotNegative = 1e8
    when_full: Literal["stop", "free"] = "stop"
    budget: NotNegative = 0.0
    ring_bytes: Positive = 256e6

    def __post_init__(self) -> None:
        if 0 < self.budget < _LEAST_BUDGET:
            raise ValueError(
                f"budget is {self.budget:g} bytes, of which not even the running file has room; "
                f"give {_LEAST_BUDGET:g} and more, or 0 for any number"
            )
