"""Nodes' diagnostics as Prometheus's families of samples."""

from collections.abc import Iterable, Iterator, Mapping

from prometheus_client.metrics_core import Metric as Family

from trigpoint.contract.messages import Diagnostics, DiagnosticStatus

from .table import LEVEL, REPORTED, Metric, is_left_out, metric_of

_WHO = {"edge": "camera", "robot": "robot"}


def families(site: str, heard: Iterable[Diagnostics]) -> list[Family]:
    """The families of these diagnostics, one each of a node, in the order of their names. States
    in words that no row of the table has are left out."""
    found: dict[str, Family] = {}
    for diagnostics in heard:
        for status in diagnostics.statuses:
            for metric, labels, value in _samples(diagnostics.stamp_ns, status):
                family = found.get(metric.name) or _family(metric)
                found[metric.name] = family
                family.add_sample(metric.name, _node_labels(site, status.name) | labels, value)
    return [found[name] for name in sorted(found)]


def _family(metric: Metric) -> Family:
    return Family(metric.name.removesuffix("_total"), metric.help, metric.type)


def _node_labels(site: str, node: str) -> dict[str, str]:
    kind, _, name = node.partition("/")
    who = {_WHO[kind]: name} if kind in _WHO else {}
    return {"site": site, "node": node} | who


def _samples(
    stamp_ns: int, status: DiagnosticStatus
) -> Iterator[tuple[Metric, dict[str, str], float]]:
    kind = status.name.partition("/")[0]
    own: Mapping[str, str] = {LEVEL: str(status.level), REPORTED: str(stamp_ns)}
    for name, text in (own | status.values).items():
        if is_left_out(name):
            continue
        metric, labels = metric_of(kind, name)
        if metric.text:
            yield metric, labels | {metric.text: text}, 1.0
        elif (value := _number(text)) is not None:
            yield metric, labels, value * metric.scale


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
