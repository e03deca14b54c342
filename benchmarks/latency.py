"""From exposure to correction, stage by stage, in a recording.

    python -m benchmarks latency [DIR]

DIR: a demo's folder, or any session's. A stage ends when the camera's agent has sent its sightings,
when fusion has sent the correction (both by the sender's own timestamp on the bus), and when the
robot has taken it over, by the journal that a simulated robot writes.
"""

import json
from collections import defaultdict
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.contract import topics
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import PoseEstimate, Sightings
from trigpoint.recorder.session.recording import open_recording

from .table import Row, lateness_rows

# Of corrections, 95 % of them.
_GOAL_MS = 40.0


def stages_ms(folder: Path) -> dict[str, list[float]]:
    """How late after its picture's exposure each message was, milliseconds, by stage."""
    found: dict[str, list[float]] = defaultdict(list)
    for sample in open_recording(folder).samples((topics.SIGHTINGS, topics.CORRECTION)):
        message = decode(sample.topic.type_name, sample.payload)
        assert isinstance(message, Sightings | PoseEstimate)
        late_ms = (sample.published_ns - message.stamp_ns) / 1e6
        if isinstance(message, PoseEstimate):
            found["correction sent"].append(late_ms)
        elif message.faces:
            found["sightings sent"].append(late_ms)
    for journal in folder.glob("*.jsonl"):
        notes = map(json.loads, journal.read_text().splitlines())
        taken = (note for note in notes if note["kind"] == "correction")
        found["taken by the robot"] += [(n["at_ns"] - n["stamp_ns"]) / 1e6 for n in taken]
    return found


def main(
    folder: Annotated[Path, typer.Argument(help="Of a demo, or of a session.")] = Path("out/demo"),
) -> list[Row]:
    """How late a correction was, and where the time went."""
    stages = {stage: late_ms for stage, late_ms in stages_ms(folder).items() if late_ms}
    if not stages:
        typer.echo(f"{folder}: nobody sighted anything", err=True)
    return [
        row
        for stage, late_ms in stages.items()
        for row in lateness_rows("latency", f"exposure to {stage}", late_ms, _GOAL_MS)
    ]
