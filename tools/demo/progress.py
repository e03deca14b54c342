"""What a demo says while it runs: one line that is written over, or now and then a new one."""

from collections.abc import Callable

from trigpoint.base.words import plus_minus

from .watch import Watch

_TERMINAL_PERIOD_S = 1.0
_FILE_PERIOD_S = 10.0
_ERASE = "\r\x1b[2K"


class Progress:
    """`write` gets text as it is to appear; `is_terminal`: lines can be written over there."""

    def __init__(self, write: Callable[[str], None], *, is_terminal: bool) -> None:
        self._write, self._is_terminal = write, is_terminal
        self._period_s = _TERMINAL_PERIOD_S if is_terminal else _FILE_PERIOD_S
        self._due_s = 0.0
        self._is_open = False

    def say(self, line: str) -> None:
        """One line that stays."""
        self._write(f"{_ERASE if self._is_open else ''}{line}\n")
        self._is_open = False

    def show(self, now_s: float, line: str) -> None:
        """How it stands at a world time, as often as fits."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + self._period_s
        if self._is_terminal:
            self._write(f"{_ERASE}{line}")
            self._is_open = True
        else:
            self._write(f"{line}\n")

    def close(self) -> None:
        """End the line that is written over."""
        if self._is_open:
            self._write("\n")
            self._is_open = False


def status_line(watch: Watch, now_s: float, cameras: int) -> str:
    parts = [f"{len(watch.cameras)}/{cameras} cameras located"]
    if watch.robots:
        sigma_m = max(watch.robots.values())
        parts.append(f"robot {plus_minus(sigma_m)}")
    parts.append(f"{watch.total('pictures')} pictures, {watch.total('faces')} faces seen")
    parts.append(f"{watch.total('corrections_accepted')} corrections")
    minutes, seconds = divmod(max(0, int(now_s)), 60)
    return f"  {minutes}:{seconds:02d}  " + " · ".join(parts)
