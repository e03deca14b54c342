"""The door for Python: what `import trigpoint as tp` offers, opened when it is first asked for.

Thin: the commands' own work, without their printing. docs/python.md says what is public.
"""

import importlib
from typing import Any

_EXTRAS = {
    "networks": "",
    "pictures": "edge",
    "sessions": "recorder",
    "calibration": "fusion,recorder",
}
"""Module -> the extra that it needs."""


def load(place: str, name: str) -> Any:
    """What `name` is in a module, or the module itself if it is its name; raise MissingExtraError
    where a package is not installed."""
    try:
        module = importlib.import_module(place)
        return module if place.endswith(f".{name}") else getattr(module, name)
    except ModuleNotFoundError as error:
        from trigpoint.cli import missing_extra  # typer is slow to import, and seldom needed

        extra = _EXTRAS.get(place.rpartition(".")[2], "")
        missing = missing_extra(error, f"trigpoint.{name}", extra)
        if missing is None:
            raise
        raise missing from None
