"""Diagnostics as Prometheus's samples, and that the table has whatever the nodes count."""

import re
from pathlib import Path

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.openmetrics import exposition as openmetrics
from prometheus_client.openmetrics.parser import (
    text_string_to_metric_families as openmetrics_families,
)
from prometheus_client.parser import text_string_to_metric_families

from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.metrics.families import families
from trigpoint.metrics.metric import Metric
from trigpoint.metrics.table import EVERY, METRICS, OTHERS, metric_of
from trigpoint.node.health import Health, Level
from trigpoint.robot.gate.safety import Refusal

ROOT = Path(__file__).parents[4]
CALL = re.compile(r"\.(count|lose|gauge|observe)\(\s*f?\"([^\"]+)\"")
SUFFIX = {"count": ".total", "lose": ".lost", "gauge": "", "observe": ".seconds"}


class Collector:
    """What a registry collects of nodes' diagnostics: name of a node -> its values."""

    def __init__(self, nodes: dict[str, dict[str, str]]) -> None:
        self._nodes = nodes

    def collect(self) -> list:
        statuses = (
            DiagnosticStatus(Level.WARN, name, "", "host", values)
            for name, values in self._nodes.items()
        )
        return families("lab", [Diagnostics(5_000_000_000, (status,)) for status in statuses])


def registry_of(nodes: dict[str, dict[str, str]]) -> CollectorRegistry:
    registry = CollectorRegistry()
    registry.register(Collector(nodes))
    return registry


def samples(name: str, health: Health) -> dict[str, tuple[dict[str, str], float]]:
    """Of every metric of one node's diagnostics the sample of most, as a Prometheus reads it."""
    page = generate_latest(registry_of({name: health.report().values})).decode()
    read = [one for family in text_string_to_metric_families(page) for one in family.samples]
    read.sort(key=lambda one: one.value)
    return {one.name: (one.labels, one.value) for one in read}


def test_a_cameras_counters_have_names_units_and_labels() -> None:
    health = Health()
    health.count("pictures", 7)
    health.lose("pictures", 2)
    health.lose("frozen", 3)
    health.gauge("certificate_days", lambda: 0.5)
    health.describe("source", "running")
    health.count("sent lab/camera/c1/sightings", 6)
    found = samples("edge/c1", health)
    who = {"site": "lab", "node": "edge/c1", "camera": "c1"}
    counted_never = (
        *("detections_given_up", "faces", "nudges", "pictures_passed_over"),
        *("rejected", "source_lost", "unsent"),
    )
    assert found == {f"trigpoint_{name}_total": (who, 0.0) for name in counted_never} | {
        "trigpoint_node_level": (who, 1.0),
        "trigpoint_report_timestamp_seconds": (who, 5.0),
        "trigpoint_pictures_total": (who, 7.0),
        "trigpoint_pictures_skipped_total": (who, 2.0),
        "trigpoint_pictures_unusable_total": (who | {"reason": "frozen"}, 3.0),
        "trigpoint_certificate_left_seconds": (who, 43200.0),
        "trigpoint_source_state": (who | {"state": "running"}, 1.0),
        "trigpoint_sent_total": (who | {"key": "lab/camera/c1/sightings"}, 6.0),
    }


def test_why_a_state_is_so_makes_no_series_of_its_own() -> None:
    health = Health()
    states = set()
    for count in (3, 4):
        health.describe("localisation", f"unknown: {count} agree, 10 are needed")
        (labels, _) = samples("robot/r1", health)["trigpoint_localisation_state"]
        states.add(labels["state"])
    assert states == {"unknown"}


def test_what_the_table_does_not_have_keeps_its_name_as_a_label() -> None:
    health = Health()
    health.count("sparks", 4)
    health.lose("nerve")
    health.gauge("mood", lambda: 0.5)
    health.describe("place", "in the hall")  # words are no metric
    found = samples("robot/r1", health)
    assert {
        name: (labels["name"], value) for name, (labels, value) in found.items() if "other" in name
    } == {
        "trigpoint_other_total": ("sparks", 4.0),
        "trigpoint_other_lost_total": ("nerve", 1.0),
        "trigpoint_other_value": ("mood", 0.5),
    }


def test_a_histogram_is_cumulative_and_has_its_sum_and_count() -> None:
    values = {"detection.seconds": "0.046 0 1 0 0 3", "sighting_delay.seconds": "no histogram"}
    page = generate_latest(registry_of({"edge/c1": values})).decode()
    read = {family.name: family for family in text_string_to_metric_families(page)}
    assert "trigpoint_sighting_delay_seconds" not in read
    family = read["trigpoint_detection_seconds"]
    assert family.type == "histogram"
    found = {(one.name, one.labels.get("le")): one.value for one in family.samples}
    bucket = "trigpoint_detection_seconds_bucket"
    assert [found.pop((bucket, le)) for le in ("0.001", "0.0025", "0.01", "0.025", "+Inf")] == [
        *(0.0, 1.0, 1.0, 4.0, 4.0)
    ]
    assert found["trigpoint_detection_seconds_sum", None] == 0.046
    assert found["trigpoint_detection_seconds_count", None] == 4.0


def any_value(metric: Metric) -> tuple[str, str]:
    """A value that becomes a metric, by its name."""
    name = re.sub(r"\{\w+:([^|}]+)[^}]*\}", r"\1", metric.value)
    text = "words" if metric.text else "1.5 2 1" if metric.type == "histogram" else "3"
    return re.sub(r"\{\w+\}", "any", name).replace("odometry .+", "odometry r1"), text


def test_every_row_is_read_by_prometheus_in_both_of_its_formats() -> None:
    """Prometheus asks for OpenMetrics where it can have it, which allows less."""
    nodes = {
        f"{kind}/n1": dict(any_value(metric) for metric in (*METRICS[EVERY], *rows, *OTHERS))
        for kind, rows in METRICS.items()
        if kind != EVERY
    }
    registry = registry_of(nodes)
    rows = [metric for rows in (*METRICS.values(), OTHERS) for metric in rows]
    wanted = {metric.name.removesuffix("_total"): metric.type for metric in rows}
    text = generate_latest(registry).decode()
    assert {f.name: f.type for f in text_string_to_metric_families(text)} == wanted
    text = openmetrics.generate_latest(registry).decode()
    assert {f.name: f.type for f in openmetrics_families(text)} == wanted


def test_whatever_a_robot_may_refuse_begins_at_nothing() -> None:
    page = generate_latest(registry_of({"robot/r1": {}})).decode()
    (refused,) = (
        family
        for family in text_string_to_metric_families(page)
        if family.name == "trigpoint_corrections_refused"
    )
    found = {one.labels["reason"]: one.value for one in refused.samples}
    reasons = {*Refusal, "not_connected", "by_robot"} - {Refusal.WAITING}
    assert found == dict.fromkeys(reasons, 0.0)


def test_a_recorders_losses_of_a_key_begin_with_its_first_message() -> None:
    values = {"recorded a.total": "3", "recorded b.total": "2", "file b.lost": "1"}
    page = generate_latest(registry_of({"recorder": values})).decode()
    (lost,) = (
        family
        for family in text_string_to_metric_families(page)
        if family.name == "trigpoint_recording_lost"
    )
    assert {one.labels["key"]: one.value for one in lost.samples} == {"a": 0.0, "b": 1.0}


def counted() -> list[tuple[str, str]]:
    """(kind, value) of everything that the parts' code counts, loses or gauges by name."""
    found = []
    for kind, folder in (
        ("edge", "edge"),
        ("robot", "robot"),
        ("fusion", "fusion"),
        ("recorder", "recorder"),
        ("edge", "trigpoint/node"),
    ):
        for path in (ROOT / folder).rglob("*.py"):
            for call, name in CALL.findall(path.read_text(encoding="utf-8")):
                part = "view" if "viewer" in path.parts else kind
                found.append((part, re.sub(r"\{[^}]*\}", "x", name) + SUFFIX[call]))
    return found


def test_every_counter_and_gauge_of_the_parts_has_a_metric_of_its_own() -> None:
    values = counted()
    assert ("robot", "corrections_refused_x.lost") in values  # the search finds them
    rows = {
        (kind, re.sub(r"\{[^}]*\}", "x", row.value))
        for kind, them in METRICS.items()
        for row in them
    }
    unnamed = {value for value in values if metric_of(*value)[0] in OTHERS}
    assert unnamed <= rows


def test_names_follow_prometheus_and_are_each_others_only() -> None:
    rows = [metric for rows in (*METRICS.values(), OTHERS) for metric in rows]
    assert len({metric.name for metric in rows}) == len(rows)
    for metric in rows:
        assert re.fullmatch(r"trigpoint_[a-z_]+", metric.name)
        assert not re.search(r"_(ms|us|ppm|ns|s|m)$", metric.name)
        assert metric.type == "counter" or not metric.value.endswith((".total", ".lost"))
