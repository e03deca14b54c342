"""The page of metrics, the alert rules and the dashboard name what there is, and nothing else."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

from ruamel.yaml import YAML

from trigpoint.metrics.table import METRICS, OTHERS

DOCS = Path(__file__).parents[3] / "docs"
ROWS = {metric.name: metric for rows in (*METRICS.values(), OTHERS) for metric in rows}
CHOICE = re.compile(r":[^}]+(?=\})")
HISTOGRAM = "_(?:bucket|sum|count)"
WHO = {"site", "node", "camera", "robot"}


def test_the_page_of_metrics_is_the_table() -> None:
    page = (DOCS / "reference/metrics.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| `(trigpoint_\w+)` \| (.*) \|$", page, re.MULTILINE)
    assert {name: rest.split(" | ") for name, rest in found} == {
        metric.name: [
            metric.type,
            " ".join(f"`{label}`" for label in metric.labels) or "–",
            metric.help,
            f"`{CHOICE.sub('', metric.value)}`",
        ]
        for metric in ROWS.values()
    }


def expressions() -> Iterator[tuple[str, str]]:
    """(expression, what is written about its result) of every alert and panel."""
    rules = YAML(typ="safe").load(DOCS / "metrics/trigpoint-alerts.yaml")
    for group in rules["groups"]:
        for rule in group["rules"]:
            yield rule["expr"], rule["annotations"]["summary"]
    dashboard = json.loads((DOCS / "metrics/trigpoint-dashboard.json").read_text(encoding="utf-8"))
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            yield target["expr"], target["legendFormat"]


def series_of(name: str) -> str:
    """The metric that a series in an expression belongs to: a histogram's are of three kinds."""
    metric = re.sub(f"{HISTOGRAM}$", "", name)
    return metric if metric in ROWS and ROWS[metric].type == "histogram" else name


def test_a_histogram_itself_is_no_series() -> None:
    assert series_of("trigpoint_detection_seconds_bucket") in ROWS
    assert series_of("trigpoint_peers_count") not in ROWS


def test_alerts_and_dashboard_use_metrics_and_labels_that_exist() -> None:
    for expression, words in expressions():
        names = {series_of(name) for name in re.findall(r"trigpoint_\w+", expression)}
        assert names <= ROWS.keys(), expression
        used = re.findall(r"\{\{ ?(?:\$labels\.)?(\w+) ?\}\}", words)
        known = WHO.union(*(ROWS[name].labels for name in names)) | {"instance"}
        assert set(used) <= known, (expression, words)
        counters = re.findall(rf"(\w+\()?(trigpoint_\w+(?:_total|{HISTOGRAM}))\b", expression)
        assert all(function in ("rate(", "increase(") for function, _ in counters), expression
