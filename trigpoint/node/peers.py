"""What a node learns from the others' diagnostics: a double of itself, another contract."""

import logging
import time

from trigpoint import CONTRACT
from trigpoint.contract.messages import DiagnosticStatus

from .health import Level

_log = logging.getLogger(__name__)

_MEMORY_S = 5.0
_MOST_COMPLAINTS = 20
MET = "met"
"""Diagnostics value: which servers of the site a node has heard since it started."""
SERVERS = {"fusion": "fusion", "recorder": "main"}
"""The kinds of node of which a site has one: kind -> its name."""


class Peers:
    """Collects complaints about other nodes; used by one thread."""

    def __init__(self, label: str, unique: str, born_ns: int) -> None:
        self._label, self._unique, self._born_ns = label, unique, born_ns
        self._complaints: dict[str, float] = {}
        self._servers_s: dict[str, float] = {}
        self._troubles: dict[str, str] = {}

    def meet(self, status: DiagnosticStatus) -> bool:
        """Take note of another node; return whether it has this node's name and is older.

        Ages are compared by the start times that both announce, so that the two agree.
        """
        unique = status.values.get("node", "")
        if not unique or unique == self._unique:
            return False
        if (kind := status.name.partition("/")[0]) in SERVERS:
            self._servers_s[kind] = time.monotonic()
            self._troubles[kind] = status.message if status.level >= Level.ERROR else ""
        where = f"{status.name} (host {status.hardware_id}, process {status.values.get('process')})"
        if status.values.get("contract") != str(CONTRACT):
            theirs = status.values.get("contract")
            self._complain(f"{where} speaks contract {theirs}, this node {CONTRACT}; update one")
        if status.name != self._label:
            return False
        self._complain(f"a second {where} is on the site; stop one of the two")
        return (_number(status.values.get("started", "")), unique) < (self._born_ns, self._unique)

    @property
    def met(self) -> str:
        """The servers heard so far, as the diagnostics tell them."""
        return ", ".join(sorted(self._servers_s))

    def silent_s(self, server: str) -> float | None:
        """How long nothing has been heard of a server; None if it never was. Any thread."""
        heard_s = self._servers_s.get(server)
        return None if heard_s is None else time.monotonic() - heard_s

    def trouble_of(self, server: str) -> str:
        """What a server says is wrong with it, "" where nothing is. Any thread."""
        return self._troubles.get(server, "")

    def complaint(self) -> str:
        """What is wrong with the other nodes now, "" if nothing is."""
        now_s = time.monotonic()
        for text, last_s in list(self._complaints.items()):
            if now_s - last_s > _MEMORY_S:
                del self._complaints[text]
        return "; ".join(self._complaints)

    def _complain(self, text: str) -> None:
        if text not in self._complaints:
            if len(self._complaints) >= _MOST_COMPLAINTS:
                return
            _log.error("%s: %s", self._label, text)
        self._complaints[text] = time.monotonic()


def _number(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0
