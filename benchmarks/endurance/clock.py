"""A Unix clock that a soak run sets for one of its programs, by a preloaded library."""

import shutil
import subprocess
from pathlib import Path

_SOURCE = Path(__file__).with_name("set_clock.c")


class SettableClock:
    """Whoever runs behind its words `preloaded` has this machine's time, and what `set_by` adds."""

    def __init__(self, folder: Path) -> None:
        self._offset, self._library = folder / "clock_offset", folder / "set_clock.so"
        self.set_by(0.0)
        compiler = shutil.which("cc") or "gcc"
        words = [compiler, "-shared", "-fPIC", "-O2", "-Wall", "-o", str(self._library)]
        subprocess.run([*words, str(_SOURCE), "-ldl"], check=True, timeout=60)

    def set_by(self, seconds: float) -> None:
        """Set it; 0 is right again. The file stays the same, for it is mapped."""
        with self._offset.open("r+b" if self._offset.exists() else "wb") as file:
            file.write(round(seconds * 1e9).to_bytes(8, "little", signed=True))

    @property
    def preloaded(self) -> tuple[str, ...]:
        """Before a command."""
        return ("env", f"LD_PRELOAD={self._library}", f"SOAK_CLOCK={self._offset}")
