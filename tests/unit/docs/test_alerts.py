"""Prometheus's own `promtool` evaluates the alert rules over what nodes export."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.metrics.families import families
from trigpoint.node.health import Health, Level

RULES = Path(__file__).parents[3] / "docs/metrics/trigpoint-alerts.yaml"
PROMTOOL = shutil.which("promtool")


def series_of(node: str, health: Health) -> dict[str, float]:
    """Prometheus's name of a series -> its value now."""
    status = DiagnosticStatus(Level.OK, node, "", "host", health.report().values)
    found = families("lab", [Diagnostics(5_000_000_000, (status,))])
    samples = [sample for family in found for sample in family.samples]
    names = [[f"{name}={json.dumps(value)}" for name, value in s.labels.items()] for s in samples]
    return {f"{s.name}{{{', '.join(n)}}}": s.value for s, n in zip(samples, names, strict=True)}


@pytest.mark.skipif(
    PROMTOOL is None, reason="there is no promtool here; it is in Debian's package «prometheus»"
)
@pytest.mark.parametrize(
    ("node", "lost", "is_watched", "alert"),
    [
        ("edge/c1", "frozen", False, "PicturesUnusable"),
        ("robot/r1", "corrections_refused_jump", False, "CorrectionsRefused"),
        ("robot/r1", "corrections_refused_by_robot", False, "CorrectionsRefused"),
        ("robot/r1", "corrections_held_by_the_clock", False, "CorrectionsHeld"),
        ("fusion/fusion", "checkpoint", False, "CheckpointLost"),
        ("fusion/fusion", "sightings", True, "QueueDrops"),
        ("recorder/main", "file lab/tf", True, "RecordingLoses"),
    ],
)
def test_the_first_burst_is_alerted(
    node: str, lost: str, *, is_watched: bool, alert: str, tmp_path: Path
) -> None:
    """All at once, between two scrapes, by a program that lost nothing before; `is_watched`: it
    counts this from 0 on by itself."""
    health = Health()
    if is_watched:
        health.lose(lost, 0)
    before = series_of(node, health)
    health.lose(lost, 20)
    series = [
        {"series": name, "values": f"{before.get(name, '_')}x3 {value}x10"}
        for name, value in series_of(node, health).items()
    ]
    fires = f'count(ALERTS{{alertname="Trigpoint{alert}", alertstate="firing"}})'
    wanted = {"expr": fires, "eval_time": "5m", "exp_samples": [{"labels": "{}", "value": 1}]}
    tests = tmp_path / "tests.yaml"  # JSON is YAML
    unit = {"interval": "1m", "input_series": series, "promql_expr_test": [wanted]}
    tests.write_text(json.dumps({"rule_files": [str(RULES)], "tests": [unit]}), encoding="utf-8")
    assert PROMTOOL is not None
    done = subprocess.run(
        [PROMTOOL, "test", "rules", tests], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
