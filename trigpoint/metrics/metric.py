"""What a row of the table of metrics says, and which values of the diagnostics it takes."""

import re
from functools import cache

from msgspec import Struct

LEVEL, REPORTED = "level", "reported"
"""Values beside the diagnostics' own: the status's level, and when it was read, ns."""
_SCALES = {"_days": 86400.0, "_ms": 1e-3, "_us": 1e-6, "_ppm": 1e-6}
"""Units in the names of values -> what makes Prometheus's unit of them."""


class Metric(Struct, frozen=True):
    """One row. `value`: the value's name in the diagnostics, in which {label} stands for text that
    becomes a label, and {label:a|b} for one of these. With `text`, the value is no number but
    words, which become the label of that name, and the metric is 1."""

    name: str
    value: str
    help: str
    text: str = ""

    @property
    def type(self) -> str:
        """counter, histogram or gauge, as Prometheus has it."""
        if self.value.endswith(".seconds"):
            return "histogram"
        return "counter" if self.name.endswith("_total") else "gauge"

    @property
    def scale(self) -> float:
        """What makes Prometheus's unit of the value."""
        if self.value in (REPORTED, "started"):
            return 1e-9
        return next((s for unit, s in _SCALES.items() if self.value.endswith(unit)), 1.0)

    @property
    def labels(self) -> tuple[str, ...]:
        """Its own labels; `site`, `node` and `camera` or `robot` are every metric's."""
        own = tuple(re.findall(r"\{(\w+)", self.value))
        return (*own, self.text) if self.text else own

    @property
    def known_labels(self) -> tuple[dict[str, str], ...]:
        """Every set of its own labels, where the row says which there are."""
        choices = re.search(r"\{(\w+)(?::([\w|]+)\})?", self.value)
        if choices is None:
            return ({},)
        label, names = choices.groups()
        return tuple({label: name} for name in names.split("|")) if names else ()

    def match(self, value: str) -> dict[str, str] | None:
        """The labels in a value's name; None where it is not this metric's."""
        found = _pattern(self.value).fullmatch(value)
        return None if found is None else found.groupdict()


@cache
def _pattern(value: str) -> re.Pattern[str]:
    parts = re.split(r"\{(\w+)(?::([^}]+))?\}", value)
    text = re.escape(parts[0])
    for label, choice, rest in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        text += f"(?P<{label}>{choice or '.+'}){re.escape(rest)}"
    return re.compile(text)
