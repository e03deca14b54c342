"""From exposure to correction through the whole site, beside the sum of its parts measured alone.

    python -m benchmarks.latency [--seconds 90]

The lab's programs run as they do in a site: three simulated cameras' agent, fusion, the bridge and
the robot; a correction has come when the robot has taken it over. Then each part runs alone: the
agent (exposure, picture, detection, bus), the filter over the messages that came (computing only),
the bridge (bus, judging, line). On a machine that has more to do than cores the programs of the
whole wait for each other, which the parts alone do not.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trigpoint import topics
from trigpoint.bus import Subscription
from trigpoint.bus_zenoh import open_bus
from trigpoint.cdr import decode
from trigpoint.clock import to_ns
from trigpoint.config import load_site
from trigpoint.fusion.inputs import load_inputs
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.messages import Message, Odometry, PoseEstimate, Sightings
from trigpoint.tools.simulation.site_files import sim_url, write_site
from trigpoint.tools.simulation.world import load_world

from .robot_bridge import measured

CAMERAS = ("c1", "c2", "c3")
_HEARD = (topics.CAMERA_INFO, topics.ODOMETRY, topics.SIGHTINGS, topics.CORRECTION)
_START_S = 15.0
_AGENT_S, _BRIDGE_S = 30.0, 20.0
# So far the session runs ahead of its solver at most.
_LEAD_NS = to_ns(20.0)


@dataclass(slots=True)
class Heard:
    """Messages in the order in which they came, with the node that sent each; how late each
    correction came after the exposure, and each sighting of a picture with a face, milliseconds."""

    messages: list[tuple[int, str, Message]] = field(default_factory=list)
    sightings_ms: list[float] = field(default_factory=list)
    corrections_ms: list[float] = field(default_factory=list)

    def take(self, subscriptions: Mapping[topics.Topic, Subscription]) -> None:
        for topic, subscription in subscriptions.items():
            while (sample := subscription.take(0.0)) is not None:
                message = decode(topic.type_name, sample.payload)
                node = topics.node_of(sample.key)
                if isinstance(message, PoseEstimate):
                    self.corrections_ms.append((sample.received_ns - message.stamp_ns) / 1e6)
                    continue
                self.messages.append((sample.received_ns, node, message))
                if isinstance(message, Sightings) and message.faces:
                    self.sightings_ms.append((sample.received_ns - message.stamp_ns) / 1e6)


class Lab:
    """A site in a folder whose programs are started by name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        world = load_world("lab", seed=1)
        for name in [name for name in world.cameras if name not in CAMERAS]:
            del world.cameras[name]
        self.epoch_ns = time.time_ns() + to_ns(_START_S)
        sources = {name: sim_url(world, name, epoch_ns=self.epoch_ns) for name in CAMERAS}
        self.site = write_site(world, folder, sources=sources, ports={"r1": "./r1.port"})
        self.journal = folder / "r1.jsonl"

    def words(self, program: str) -> list[str]:
        site = ["--site", str(self.site)]
        cameras = [word for name in CAMERAS for word in ("--camera", name)]
        firmware = ["--world", "lab", "--seed", "1", "--robot", "r1", "--log", str(self.journal)]
        firmware += ["--epoch-ns", str(self.epoch_ns), "--link", str(self.folder / "r1.port")]
        return {
            "firmware": ["trigpoint.tools.simulation.firmware", *firmware],
            "edge": ["trigpoint", "edge", *site, *cameras],
            "fusion": ["trigpoint", "fusion", *site, "--out", str(self.folder / "out")],
            "robot": ["trigpoint", "robot", *site, "--robot", "r1"],
        }[program]

    def run(self, programs: tuple[str, ...], seconds: float) -> Heard:
        """Run these until so long after the robot drove off; what was heard."""
        heard = Heard()
        with ExitStack() as stack:
            bus = stack.enter_context(open_bus(load_site(self.site)))
            subscriptions = {t: bus.subscribe(t, t.expression("lab")) for t in _HEARD}
            for program in programs:
                words = [sys.executable, "-m", *self.words(program)]
                with (self.folder / f"{program}.log").open("ab") as log:
                    process = subprocess.Popen(words, stdout=log, stderr=log)
                stack.callback(process.wait, 20)
                stack.callback(process.terminate)
            end_ns = self.epoch_ns + to_ns(seconds)
            while time.time_ns() < end_ns:
                time.sleep(0.2)
                heard.take(subscriptions)
        heard.messages.sort(key=lambda row: row[0])
        return heard

    @property
    def corrections_ms(self) -> list[float]:
        """How late the robot took over each correction, by its own journal."""
        notes = [json.loads(line) for line in self.journal.read_text().splitlines()]
        taken = [note for note in notes if note["kind"] == "correction"]
        return [(note["at_ns"] - note["stamp_ns"]) / 1e6 for note in taken]


def filtered_ms(lab: Lab, heard: Heard) -> list[float]:
    """What the filter computes for each sighting that leads to a correction."""
    inputs, took_ms = load_inputs(load_site(lab.site), network=None), list[float]()
    solver = SolverProcess(inputs.data_set())
    try:
        pipeline = Pipeline(inputs, is_live=False, solver=solver)
        pipeline.resumed(is_new=True)
        spent_s, asked_ns = 0.0, 0
        for _, node, message in heard.messages:
            begin_s = time.perf_counter()
            pipeline.push(node, message)
            if isinstance(message, Sightings):
                spent_s += time.perf_counter() - begin_s
            if not isinstance(message, Odometry):
                continue
            outputs = pipeline.advance(message.stamp_ns)
            spent_s += time.perf_counter() - begin_s
            if any(output.topic is topics.CORRECTION for output in outputs):
                took_ms.append(1e3 * spent_s)
            spent_s = 0.0
            if message.stamp_ns - asked_ns > _LEAD_NS:
                asked_ns = message.stamp_ns
                pipeline.ask()
                while not pipeline.is_answered:
                    time.sleep(0.05)
                    pipeline.advance()
    finally:
        solver.close()
    return took_ms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=90.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        lab = Lab(Path(folder) / "whole")
        heard = lab.run(("firmware", "fusion", "edge", "robot"), seconds)
        whole = lab.corrections_ms
        alone = Lab(Path(folder) / "agent").run(("edge",), _AGENT_S).sightings_ms
        parts = {"agent": alone, "filter": filtered_ms(lab, heard)}
    run, told = measured(50.0, _BRIDGE_S)
    parts["bridge"] = list(run.correction_ms(told))
    marks = {name: np.percentile(values, [50, 95]) for name, values in parts.items()}
    for name, (half, most) in marks.items():
        print(f"{name} alone: p50 {half:.1f}, p95 {most:.1f} ms ({len(parts[name])})")
    for what, values in (("sightings", heard.sightings_ms), ("corrections", heard.corrections_ms)):
        half, most = np.percentile(values, [50, 95])
        print(f"in the whole, exposure to {what} on the bus: p50 {half:.1f}, p95 {most:.1f} ms")
    half, most = np.percentile(whole, [50, 95])
    ratio = most / sum(mark[1] for mark in marks.values())
    print(f"exposure to correction at the robot: p50 {half:.1f}, p95 {most:.1f} ms ({len(whole)})")
    print(f"p95 over the sum of the parts' p95: {ratio:.2f}")


if __name__ == "__main__":
    main()
