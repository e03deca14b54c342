"""Programs stopped at drawn moments, by either signal, alone or as a group: each ends by itself,
and what it should have written is written, or its log says why not.

    python -m benchmarks.endurance.stops
"""

import random
import socket
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from signal import SIGINT, SIGTERM
from typing import Annotated

import cv2
import numpy as np
import typer
from support.fusion.drives import lab_plan, make_session
from support.site.programs import Drive, Field, Program, lay_out, meeting_point

_LATEST_S = 6.0
MORE = """
[cameras.folder]
source = "dir://pictures"
intrinsics = "estimate"
"""


def main(
    count: Annotated[int, typer.Option(help="How many stops.")] = 200,
    seed: Annotated[int, typer.Option(help="Draws the moments.")] = 1,
) -> None:
    """Stop fusion, the recorder, an agent and a view at drawn moments."""
    draw, took_s, wrong = random.Random(seed), list[float](), list[str]()
    endings: Counter[str] = Counter()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="trigpoint-stops-")))
        field = _field(folder)
        stack.enter_context(meeting_point(field))
        drive = Drive(field)
        stack.callback(drive.close)
        for number in range(count):
            name, words = draw.choice(list(_programs(field, number).items()))
            program = Program(field, *words)
            try:
                draw_s = draw.uniform(0.0, _LATEST_S)
                _wait(program, draw_s)
                stop_s = program.stop(draw.choice((SIGINT, SIGTERM)), to_group=draw.random() < 0.5)
                endings[f"{name} {program.process.returncode}"] += 1
                took_s.append(stop_s)
                if complaint := complaint_of(program, stop_s):
                    wrong.append(f"{name} after {draw_s:.2f} s: {complaint}\n{program.said}")
            finally:
                program.kill()
    took = np.array(took_s)
    print(f"{count} stops: {np.median(took):.2f} s median, {took.max():.2f} s longest; {endings}")
    print("\n".join(wrong) or "none that left anything out without saying why")
    raise typer.Exit(bool(wrong))


def complaint_of(program: Program, stop_s: float) -> str:
    """What is wrong with how a program ended, "" where nothing is."""
    said = program.said
    if stop_s < 0:
        return "it did not end"
    if program.process.returncode != 0:
        return f"its status is {program.process.returncode}"
    if "Traceback" in said or "left by force" in said:
        return "it ended in disorder"
    reasons = ("the network is in", "there is no solution yet", "stopped before")
    if program.name == "fusion" and "runs on site" in said:
        return "" if any(reason in said for reason in reasons) else "no word of its network"
    return ""


def _wait(program: Program, seconds: float) -> None:
    time.sleep(seconds)
    assert program.process.poll() is None, program.said


def _field(folder: Path) -> Field:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    (folder / "pictures").mkdir()
    picture = np.random.default_rng(1).integers(0, 255, (480, 640), np.uint8)
    cv2.imwrite(str(folder / "pictures" / "0.png"), picture)
    for number in range(1, 1000):
        (folder / "pictures" / f"{number}.png").symlink_to(folder / "pictures" / "0.png")
    return lay_out(folder, port, make_session(lab_plan("charuco", seconds=120.0)), more=MORE)


def _programs(field: Field, number: int) -> dict[str, tuple[str, ...]]:
    return {
        "fusion": ("fusion", "--out", str(field.folder / f"network{number}")),
        "record": ("record", "--out", str(field.folder / f"session{number}")),
        "edge": ("edge", "--camera", "folder"),
        "view": ("view", "--web"),
    }


if __name__ == "__main__":
    typer.run(main)
