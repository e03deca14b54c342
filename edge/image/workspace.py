"""Memory for what is worked out of a picture, kept for the next one."""

import numpy as np


class Workspace:
    """Named arrays; for one thread.

    Fresh memory of a picture's size comes from the kernel page by page, which took longer (4 ms at
    640 × 480) than all that is worked out in it.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}
        self._memory: dict[str, np.ndarray] = {}

    def array(
        self, name: str, shape: tuple[int, ...], dtype: type[np.generic] = np.float32
    ) -> np.ndarray:
        """The array of this name: the last one, with whatever is in it, where it fits; in the same
        memory where that is large enough, as for parts of pictures."""
        kept = self._arrays.get(name)
        if kept is None or kept.shape != shape or kept.dtype != dtype:
            memory, size = self._memory.get(name), int(np.prod(shape))
            if memory is None or memory.size < size or memory.dtype != dtype:
                memory = self._memory[name] = np.zeros(size, dtype)
            kept = self._arrays[name] = memory[:size].reshape(shape)
        return kept
