"""Holds samples back until a session that had lost everybody is known again.

A subscriber that met a publisher's next sample before the news of who has the earlier ones asked
nobody for those, and they were lost (once in eight times that a router died on a network that loses
packets). So samples that must be recovered wait until that news has got round.
"""

import time
from collections.abc import Callable

# All come back within the second after which each tries again at most (`bus_settings`).
ANNOUNCE_S = 1.0


class Reunion:
    """`meets`: whether the session has a link to anybody now. Asked at each put."""

    def __init__(
        self, meets: Callable[[], bool], elapsed_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._meets, self._elapsed_s = meets, elapsed_s
        self._is_met = meets()
        self._until_s = elapsed_s()

    @property
    def wait_s(self) -> float:
        """How long to wait before the next sample is sent; 0 or less where nothing is in the way.
        To nobody it is sent at once, which keeps it for whoever asks."""
        was_met, self._is_met = self._is_met, self._meets()
        if self._is_met and not was_met:
            self._until_s = self._elapsed_s() + ANNOUNCE_S
        return self._until_s - self._elapsed_s() if self._is_met else 0.0
