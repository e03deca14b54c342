"""Summarises what a site's nodes report about themselves."""

import textwrap
from collections.abc import Collection, Iterable, Sequence

from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.words import loss_words, numberless
from trigpoint.contract.messages import DiagnosticStatus
from trigpoint.contract.topics import SIGHTINGS, topic_of
from trigpoint.node.health import LOST_SO_FAR
from trigpoint.node.peers import MET, SERVERS

_NO_GAUGES = frozenset({
    "version",
    "contract",
    "session",
    "node",
    "process",
    "started",
    "uptime",
    "last_error",
    MET,
})  # fmt: skip
_NAMED = {"edge": "camera", "robot": "robot"}
_FACES = "faces"
STATES = ("ok", "warning", "error", "stale")


class NodeStatus(Struct, frozen=True):
    """One node. `state`: ok, warning, error, or silent (alive without diagnostics), gone
    (diagnostics without a token), or missing (named in the site file, but nobody runs it). Rates
    are a second; losses are totals since the node's start; `words`: states like its source's."""

    name: str
    state: str
    message: str = ""
    host: str = ""
    version: str = ""
    contract: str = ""
    uptime_s: float = 0.0
    rates: dict[str, float] = {}
    totals: dict[str, int] = {}
    depths: dict[str, int] = {}
    losses: dict[str, int] = {}
    gauges: dict[str, float] = {}
    words: dict[str, str] = {}
    last_error: str = ""

    @property
    def is_well(self) -> bool:
        """Whether the node is running without an error."""
        return self.state in ("ok", "warning")


class SiteStatus(Struct, frozen=True):
    """All nodes of a site, by name; `peers`: how many sessions the bus is connected to;
    `versions`: the nodes of each version that runs; `time`: when they were looked at, ISO 8601
    with its zone; `link`: why nodes may be there that were not heard, "" if none may."""

    site: str
    peers: int
    nodes: list[NodeStatus]
    versions: dict[str, list[str]] = {}
    time: str = ""
    link: str = ""

    @property
    def is_well(self) -> bool:
        """Whether no node is missing or in error, and all could be heard."""
        return not self.link and all(node.is_well for node in self.nodes)


def summarise(
    site: str,
    *,
    peers: int,
    tokens: Iterable[str],
    statuses: Iterable[DiagnosticStatus],
    wanted: Iterable[str] = (),
    known: Iterable[str] | None = None,
    expect: Iterable[str] | None = None,
    time: str = "",
    unreached: Sequence[str] = (),
) -> SiteStatus:
    """Combine liveliness tokens with the nodes' latest diagnostics; `wanted`: the nodes named in
    the site file; `known`: all agents and bridges that it may have, None: any; `expect`: the kinds
    of node needed beside them, by default those that another node has heard since it started;
    `unreached`: where nobody answers, so that it is not known who is missing."""
    alive = {token.partition("/alive/")[2] for token in tokens}
    latest = {(status.name, status.values.get("node", "")): status for status in statuses}
    nodes = [_node(status, status.name in alive) for status in latest.values()]
    if known is not None:
        kept = frozenset(known)
        nodes = [_checked(node, kept) for node in nodes]
    spoken = {name for name, _ in latest}
    nodes += [NodeStatus(name, "silent", "alive, but says nothing") for name in alive - spoken]
    link = ""
    if unreached:
        wanted, expect = (), ()
        link = (
            f"nobody answers at {', '.join(unreached)} (bus.connect); see whether the router, or "
            "the machine that listens, is on"
        )
    missing = set(wanted) - alive - spoken
    nodes += [
        NodeStatus(name, "missing", "named in the site file; not running") for name in missing
    ]
    nodes += _absent(expect, {name.partition("/")[0] for name in alive | spoken}, latest.values())
    nodes.sort(key=lambda node: node.name)
    return SiteStatus(site, peers, nodes, _versions(nodes), time, link)


def _checked(node: NodeStatus, known: Collection[str]) -> NodeStatus:
    """The node, with a warning where it is a camera's or robot's that the site file does not
    have."""
    kind, _, name = node.name.partition("/")
    if kind not in _NAMED or node.name in known or node.state == "gone":
        return node
    text = (
        f"the site file has no {_NAMED[kind]} «{name}», so others may leave it out; add it there "
        "and start them again, or stop this one"
    )
    said = "; ".join(filter(None, (text, _complaint(node))))
    return replace(node, state="warning" if node.state == "ok" else node.state, message=said)


def _complaint(node: NodeStatus) -> str:
    """What a node says is wrong with it, but for its losses, which have numbers of their own."""
    is_none = node.message == "running" or node.message.startswith(LOST_SO_FAR)
    return "" if is_none else node.message


def _absent(
    expect: Iterable[str] | None, present: set[str], statuses: Iterable[DiagnosticStatus]
) -> list[NodeStatus]:
    """The nodes of the kinds that are expected, but of which none is there."""
    if expect is not None:
        kinds, why = set(expect), "expected by the site file (`expect`); not running"
    else:
        heard = (status.values.get(MET, "") for status in statuses)
        kinds = {kind for text in heard for kind in text.split(", ") if kind}
        why = (
            "was running, and is not any more; where the site does not need it, write `expect` at "
            "the top of the site file"
        )
    names = [f"{kind}/{SERVERS.get(kind, kind)}" for kind in kinds - present]
    return [NodeStatus(name, "missing", why) for name in names]


def _versions(nodes: list[NodeStatus]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for node in nodes:
        if node.version and node.state != "gone":
            found.setdefault(node.version, []).append(node.name)
    return dict(sorted(found.items(), key=lambda item: (-len(item[1]), item[0])))


def _node(status: DiagnosticStatus, is_alive: bool) -> NodeStatus:
    values = status.values
    numbers: dict[str, dict[str, float]] = {"rate": {}, "total": {}, "depth": {}, "lost": {}}
    gauges: dict[str, float] = {}
    words: dict[str, str] = {}
    for name, text in values.items():
        stem, dot, kind = name.rpartition(".")
        if dot and kind in numbers:
            numbers[kind][stem] = number_said(text)
        elif not dot and name not in _NO_GAUGES:
            if (number := _number(text)) is None:
                words[name] = text
            else:
                gauges[name] = number
    state = STATES[status.level] if is_alive else "gone"
    return NodeStatus(
        name=status.name,
        state=state,
        message=status.message,
        host=status.hardware_id,
        version=values.get("version", ""),
        contract=values.get("contract", ""),
        uptime_s=number_said(values.get("uptime", "")),
        rates=numbers["rate"],
        totals={name: int(total) for name, total in numbers["total"].items()},
        depths={name: int(depth) for name, depth in numbers["depth"].items()},
        losses={name: int(lost) for name, lost in numbers["lost"].items()},
        gauges=gauges,
        words=words,
        last_error=values.get("last_error", ""),
    )


def _number(text: str) -> float | None:
    """A number sent by another node, 0 where it cannot be meant; None if it is no number."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e15 else 0.0


def number_said(text: str) -> float:
    """A number sent by another node; 0 if it is not a number."""
    return _number(text) or 0.0


def table(status: SiteStatus, *, width: int = 100) -> str:
    """The status for people, in lines of at most `width` if their words allow it."""
    if not status.nodes:
        alone = f"Nobody is alive on site {status.site} ({status.peers} sessions on the bus)."
        return f"Of site {status.site} nobody is heard: {status.link}." if status.link else alone
    rows = [("node", "state", "up")]
    rows += [(node.name, node.state, f"{node.uptime_s:.0f} s") for node in status.nodes]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    heads = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    lines = [
        f"Site {status.site}, {status.peers} other sessions on the bus",
        f"{heads[0]}  what it does a second, what was lost, what is wrong",
    ]
    margin = " " * (len(heads[0]) + 2)
    for head, node in zip(heads[1:], status.nodes, strict=True):
        first = f"{head}  "
        for text in notes(node) or ["-"]:
            lines += textwrap.wrap(
                text,
                max(width, len(margin) + 20),
                initial_indent=first,
                subsequent_indent=margin,
                break_on_hyphens=False,
            )
            first = margin
    if status.link:
        lines.append(f"Not all are heard: {status.link}")
    if len(status.versions) > 1:
        usual, *others = status.versions
        told = "; ".join(f"{version}: {', '.join(status.versions[version])}" for version in others)
        lines.append(f"Versions differ: {usual} on most, but {told}")
    return "\n".join(lines)


def notes(node: NodeStatus) -> list[str]:
    """Remarks on a node, one per line; none for an idle one."""
    told = _by_topic(node.rates).items()
    rates = ", ".join(f"{name} {rate:g}" for name, rate in told if rate or name == _FACES)
    losses = loss_words(node.losses)
    words = ", ".join(f"{name}: {text}" for name, text in node.words.items() if text)
    found = [rates, words, losses and f"lost: {losses}"]
    found += [_complaint(node)]
    if numberless(node.last_error) not in numberless(node.message):
        found += [f"last error: {node.last_error}"]
    return [note for note in found if note]


def _by_topic(rates: dict[str, float]) -> dict[str, float]:
    """Rates of counters like «sent lab/camera/c1/sightings», summed over the cameras or robots, and
    those others that add information: «sightings» is merely the queue of what was received or
    recorded, and their messages, most of them empty, say less than the faces in them."""
    sums: dict[str, float] = {}
    for name, rate in rates.items():
        verb, _, key = name.partition(" ")
        topic = topic_of(key)
        short = f"{verb} {topic.name}" if topic is not None else name
        sums[short] = round(sums.get(short, 0.0) + rate, 1)
    told = {name.partition(" ")[2] for name in sums if name.startswith(("received ", "recorded "))}
    if _FACES in sums:
        told |= {name for name in sums if name.endswith(f" {SIGHTINGS.name}")}
    return {name: rate for name, rate in sums.items() if name not in told}
