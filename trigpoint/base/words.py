"""Wording of messages: numbers with their nouns, suggestions of similar names, commands to run."""

import difflib
import os
import re
from collections.abc import Iterable, Mapping, Sequence

from trigpoint import __version__


def counted(number: int, noun: str) -> str:
    """«1 face», «2 faces»."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def nearest(word: str, known: Iterable[str]) -> str:
    """«; did you mean «charuco»?», "" if there is nothing to choose from."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.0)
    return f"; did you mean «{close[0]}»?" if close else ""


def plus_minus(sigma_m: float) -> str:
    """A standard deviation: «±0.8 cm», «<0.1 cm», «±1.2 m»."""
    if sigma_m < 1e-3:
        return "<0.1 cm"
    return f"±{100 * sigma_m:.1f} cm" if round(sigma_m, 3) < 1 else f"±{sigma_m:.1f} m"


_KEYS = "file "  # a recorder's losses, by key
_OF_PICTURES = ("frozen", "given_up", "out_of_order", "unreadable")


def loss_words(losses: Mapping[str, int]) -> str:
    """Losses by the names of their counters: «1 picture, 3 pictures given up»; "" where there are
    none."""
    return ", ".join(_lost(name, count) for name, count in losses.items() if count)


def _lost(name: str, count: int) -> str:
    if name.startswith(_KEYS):  # which are named as they are
        return f"{count} of {name.removeprefix(_KEYS)}"
    words = f"{'pictures ' * (name in _OF_PICTURES)}{name}".replace("_", " ")
    return f"{count} {words if count > 1 else re.sub(r's(?= |$)', '', words, count=1)}"


def two_decimals(value: float) -> str:
    """«0.84»; «<0.01» of what is not nothing and would read so."""
    return "<0.01" if 0 < value < 0.005 else f"{value:.2f}"


def numberless(text: str) -> str:
    """A text without its numbers: the same for all that differ in them alone."""
    return re.sub(r"\d+", "#", text)


def listed(names: Sequence[str]) -> str:
    """«a, b or c»."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} or {names[-1]}"


def install_command(extra: str) -> str:
    """How a part is installed here, as README has it: versions that were not tested together are
    never mixed."""
    tag = f"py3-none-manylinux_2_28_{os.uname().machine}"
    wheel = f"file:///path/to/trigpoint-{__version__}-{tag}.whl"
    return f"pip install -c constraints.txt 'trigpoint[{extra}] @ {wheel}'"
