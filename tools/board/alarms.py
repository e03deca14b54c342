"""Nodes and alarms as the page shows them, in the words that `status` has. Pure."""

from collections import deque

from msgspec import Struct

from trigpoint.base.words import numberless
from trigpoint.tools.site.state import NodeStatus, SiteStatus, notes

from .entities import Fields

_OVER_S = 3.0
"""An alarm that is not said for so long is over."""
_MOST_OVER = 40
"""How many alarms that are over are still shown."""
_NODE = "node/"


class _Alarm(Struct):
    number: int
    node: str
    since_s: float
    last_s: float
    text: str
    state: str


class Alarms:
    """Turns one look at the site after the other into entities; None: an entity is gone."""

    def __init__(self) -> None:
        self._active: dict[tuple[str, str], _Alarm] = {}
        self._over: deque[int] = deque()
        self._nodes: set[str] = set()
        self._count = 0

    def look(self, status: SiteStatus, now_s: float) -> dict[str, Fields | None]:
        found: dict[str, Fields | None] = {
            f"{_NODE}{node.name}": _fields(node) for node in status.nodes
        }
        names = {node.name for node in status.nodes}
        found |= {f"{_NODE}{name}": None for name in self._nodes - names}
        self._nodes = names
        for node in status.nodes:
            if node.state != "ok":
                found |= self._say(node, now_s)
        return found | self._end(now_s)

    def _say(self, node: NodeStatus, now_s: float) -> dict[str, Fields | None]:
        text = "gone" if node.state == "gone" else node.message or node.last_error or node.state
        key = (node.name, numberless(text))
        alarm = self._active.get(key)
        if alarm is None:
            self._count += 1
            alarm = _Alarm(self._count, node.name, now_s, now_s, text, node.state)
            self._active[key] = alarm
        alarm.last_s, alarm.text, alarm.state = now_s, text, node.state
        fields: Fields = {
            "node": alarm.node,
            "text": alarm.text,
            "state": alarm.state,
            "since": round(alarm.since_s),
        }
        return {f"alarm/{alarm.number}": fields}

    def _end(self, now_s: float) -> dict[str, Fields | None]:
        found: dict[str, Fields | None] = {}
        for key in [k for k, a in self._active.items() if now_s - a.last_s > _OVER_S]:
            alarm = self._active.pop(key)
            found[f"alarm/{alarm.number}"] = {"until": round(alarm.last_s)}
            self._over.append(alarm.number)
            if len(self._over) > _MOST_OVER:
                found[f"alarm/{self._over.popleft()}"] = None
        return found


def _fields(node: NodeStatus) -> Fields:
    """`age`: of a camera's newest picture, s, 0 while it is young, and `source`: its state; None
    where the node does not say them, or not any more."""
    fields: Fields = {"state": node.state, "notes": notes(node), "host": node.host}
    gauges, words = ({}, {}) if node.state == "gone" else (node.gauges, node.words)
    age_s = gauges.get("picture_age_s")
    fields["age"] = None if age_s is None else int(age_s)
    fields["source"] = words.get("source")
    if (lost := sum(node.losses.values())) > 0:
        fields["lost"] = lost
    return fields
