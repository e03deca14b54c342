"""Memory for what is worked out of a picture, kept for the next one."""

import numpy as np


class Workspace:
    """Named arrays; for one thread.

    Fresh memory of a picture's size comes from the kernel page by page, which took longer (4 ms at
    640 × 480) than all that is worked out in it.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}

    def array(
        self, name: str, shape: tuple[int, ...], dtype: type[np.generic] = np.float32
    ) -> np.ndarray:
        """The array of this name: the last one, with whatever is in it, where it fits."""
        kept = self._arrays.get(name)
        if kept is None or kept.shape != shape or kept.dtype != dtype:
            kept = self._arrays[name] = np.zeros(shape, dtype)
        return kept
