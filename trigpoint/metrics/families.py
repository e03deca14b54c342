"""Nodes' diagnostics as Prometheus's families of samples."""

import math
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import accumulate

from prometheus_client.metrics_core import Metric as Family
from prometheus_client.utils import floatToGoString

from trigpoint.contract.durations import BOUNDS_S, Durations
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus

from .metric import LEVEL, REPORTED, Metric
from .table import EVERY, LOST_BESIDE, METRICS, is_left_out, metric_of

_WHO = {"edge": "camera", "robot": "robot"}


def families(site: str, heard: Iterable[Diagnostics]) -> list[Family]:
    """The families of these diagnostics, one each of a node, in the order of their names. States
    in words that no row of the table has are left out, and a stamp of 0, which is none."""
    found: dict[str, Family] = {}
    for diagnostics in heard:
        for status in diagnostics.statuses:
            for metric, labels, value in _samples(diagnostics.stamp_ns, status):
                family = found.get(metric.name) or _family(metric)
                found[metric.name] = family
                labels = _node_labels(site, status.name) | labels
                if isinstance(value, Durations):
                    _add_histogram(family, labels, value)
                else:
                    family.add_sample(metric.name, labels, value)
    return [found[name] for name in sorted(found)]


def _family(metric: Metric) -> Family:
    return Family(metric.name.removesuffix("_total"), metric.help, metric.type)


def _add_histogram(family: Family, labels: dict[str, str], durations: Durations) -> None:
    """Cumulative counts, as Prometheus has them, their number and the sum."""
    counts = list(accumulate(durations.counts))
    for bound, count in zip((*BOUNDS_S, math.inf), counts, strict=True):
        le = {"le": floatToGoString(bound)}
        family.add_sample(f"{family.name}_bucket", labels | le, count)
    family.add_sample(f"{family.name}_count", labels, counts[-1])
    family.add_sample(f"{family.name}_sum", labels, durations.sum_s)


def _node_labels(site: str, node: str) -> dict[str, str]:
    kind, _, name = node.partition("/")
    who = {_WHO[kind]: name} if kind in _WHO else {}
    return {"site": site, "node": node} | who


def _samples(
    stamp_ns: int, status: DiagnosticStatus
) -> Iterator[tuple[Metric, dict[str, str], float | Durations]]:
    kind = status.name.partition("/")[0]
    own = {LEVEL: str(status.level)} | ({REPORTED: str(stamp_ns)} if stamp_ns else {})
    never, said = dict(_counters(kind)) if stamp_ns else {}, set[tuple[str, ...]]()
    for name, text in (own | status.values).items():
        if is_left_out(name):
            continue
        metric, labels = metric_of(kind, name)
        said.add((metric.name, *labels.values()))
        if stamp_ns and (lost := LOST_BESIDE.get(metric.name)):
            never[lost.name, *labels.values()] = lost, labels
        if metric.text:
            # What follows a colon is why, for people; as a label it would be a series each time.
            yield metric, labels | {metric.text: text.partition(": ")[0]}, 1.0
        elif metric.type == "histogram":
            if (durations := _durations(text)) is not None:
                yield metric, labels, durations
        elif (value := _number(text)) is not None:
            yield metric, labels, value * metric.scale
    for counter, (metric, labels) in never.items():
        if counter not in said:  # else Prometheus's `increase` does not see the first
            yield metric, labels, 0.0


@cache
def _counters(kind: str) -> dict[tuple[str, ...], tuple[Metric, dict[str, str]]]:
    """The counters that each node of this kind has: name and labels' values -> row and labels."""
    return {
        (row.name, *labels.values()): (row, labels)
        for row in (*METRICS.get(kind, ()), *METRICS[EVERY])
        if row.value.endswith((".total", ".lost"))
        for labels in row.known_labels
    }


def _durations(text: str) -> Durations | None:
    try:
        return Durations.of(text)
    except ValueError:
        return None


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
