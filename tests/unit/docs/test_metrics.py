"""The page of metrics, the alert rules and the dashboard name what there is, and nothing else."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import promql_parser as promql
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


def parts_of(expression: str) -> list[promql.Expr]:
    """Every part of an expression, which is parsed and whose types are checked."""
    found: list[promql.Expr] = []
    promql.walk(promql.parse(expression), found.append)
    return found


def test_alerts_and_dashboard_use_metrics_and_labels_that_exist() -> None:
    for expression, words in expressions():
        parts = parts_of(expression)
        series = [part for part in parts if isinstance(part, promql.VectorSelector)]
        names = {str(one.name) for one in series} - {"up"}
        metrics = {series_of(name) for name in names}
        assert metrics <= ROWS.keys(), expression
        known = WHO.union({"instance"}, *(ROWS[name].labels for name in metrics))
        assert {matcher.name for one in series for matcher in one.matchers.matchers} <= known | {
            "job"
        }
        for part in parts:
            if isinstance(part, promql.AggregateExpr):  # which leaves these alone
                assert part.modifier is not None
                assert set(part.modifier.labels) <= known | {"le"}, expression
                known &= set(part.modifier.labels)
        used = re.findall(r"\{\{ ?(?:\$labels\.)?(\w+) ?\}\}", words)
        assert set(used) <= known, (expression, words)
        ranged = {
            part.vector_selector.name for part in parts if isinstance(part, promql.MatrixSelector)
        }
        counters = {name for name in names if re.search(f"(?:_total|{HISTOGRAM})$", name)}
        assert counters <= ranged, expression
        called = re.findall(rf"(\w+\()?(trigpoint_\w+(?:_total|{HISTOGRAM}))\b", expression)
        assert all(function in ("rate(", "increase(") for function, _ in called), expression
