"""Files that are written out of one beside the code, with names in it for what differs."""

import re
from pathlib import Path

_NAME = re.compile(r"@(\w+)@")


def filled(path: Path, **values: str) -> str:
    """A file's text with a value in place of each @name@; without the lines of which those leave
    nothing."""
    lines = path.read_text(encoding="utf-8").splitlines()
    texts = [(line, _NAME.sub(lambda name: values[name[1]], line)) for line in lines]
    return "\n".join(text for line, text in texts if text or not line) + "\n"
