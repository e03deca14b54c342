"""What `doctor` looks at for the recorder."""

import importlib.util
from pathlib import Path

from trigpoint.base.checks import Check
from trigpoint.base.disk import free_bytes
from trigpoint.base.words import install_command

_NEEDED = 1e9
_TOO_LITTLE = 1e8


def checks() -> list[Check]:
    """Is the part installed, does the viewer have a display, is there room to record?"""
    missing = [name for name in ("mcap", "rerun") if importlib.util.find_spec(name) is None]
    if missing:
        remedy = install_command("recorder")
        return [Check("recorder", "error", f"{', '.join(missing)} is not installed", remedy)]
    return [_viewer(), room(Path.cwd())]


def room(directory: Path) -> Check:
    """Disk space where sessions would be written; the directory itself need not be there yet."""
    free = free_bytes(directory)
    message = f"{free / 1e9:.1f} GB free for sessions at {directory.resolve()}"
    if free > _NEEDED:
        return Check("room to record", "ok", message)
    level = "error" if free < _TOO_LITTLE else "warning"
    remedy = "make room, or set `directory` under [recorder] to another disk"
    return Check("room to record", level, message, remedy)


def _viewer() -> Check:
    from .viewer.process import has_display, program

    if not program().exists():
        remedy = "run: pip install -c constraints.txt --force-reinstall rerun-sdk"
        return Check("rerun's viewer", "error", "its program is missing", remedy)
    if not has_display():
        remedy = "give `view` and `review` the option --web"
        return Check("rerun's viewer", "warning", "there is no display for its window", remedy)
    return Check("rerun's viewer", "ok", "can open a window")
