"""What pip runs to install Trigpoint or to make a wheel of it: the core is built, and goes in."""

import os
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parent))
import build

# A wheel for another machine: its platform tag, and what zig calls that machine.
TAG, TARGET = "TRIGPOINT_WHEEL_PLATFORM", "TRIGPOINT_WHEEL_TARGET"


class CoreHook(BuildHookInterface):
    """Builds the core for an editable install and for a wheel alike."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """What the build needs; a compiler only where there is none, or none for that machine."""
        needed = build.needs()
        return [build.EIGEN, build.ZIG] if TARGET in os.environ else needed

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build, and say what the wheel is for: any Python, since it is called through C."""
        platform = os.environ.get(TAG) or f"linux_{os.uname().machine}"
        target = os.environ.get(TARGET)
        library = build.LIBRARY
        if target:
            library = Path(self.directory) / platform / build.LIBRARY.name
            library.parent.mkdir(parents=True, exist_ok=True)
        build.built(target=target, library=library)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        if version != "editable":
            build_data["force_include"][str(library)] = f"trigpoint/native/{library.name}"
