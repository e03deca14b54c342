"""Holds samples back until a session that had lost all its links has been announced again.

A subscriber that received a publisher's next sample before the announcement of its cache asked
nobody for the earlier ones, and they were lost (in one of eight router failures on a lossy
network). So samples that must be recoverable wait until the announcement has spread.
"""

import time
from collections.abc import Callable

# Everyone reconnects within a second, the longest interval between retries (`bus_settings`).
ANNOUNCE_S = 1.0


class Reunion:
    """`meets`: whether the session has a link to anybody now; called at each put."""

    def __init__(
        self, meets: Callable[[], bool], elapsed_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._meets, self._elapsed_s = meets, elapsed_s
        self._is_met = meets()
        self._until_s = elapsed_s()

    @property
    def wait_s(self) -> float:
        """How long to wait before sending the next sample; 0 or less: send now. Without any link
        it is sent at once, which puts it into the cache."""
        was_met, self._is_met = self._is_met, self._meets()
        if self._is_met and not was_met:
            self._until_s = self._elapsed_s() + ANNOUNCE_S
        return self._until_s - self._elapsed_s() if self._is_met else 0.0
