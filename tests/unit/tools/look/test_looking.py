"""Whoever does what is advised gets a lens; a rolling shutter's moving boards are not used."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from support.pictures.boards import CAMERA, charuco, picture_of, placed, target_of

from trigpoint.edge.sources.frames import Frame
from trigpoint.site.camera_info import read_camera_info
from trigpoint.site.config import CameraConfig
from trigpoint.tools.look import looking
from trigpoint.tools.look.looking import Look, Wishes
from trigpoint.tools.look.shown import Shown

MOST_PICTURES = 120
CONFIG = CameraConfig("person://hall")


@dataclass
class Person:
    """A source of pictures of a board, which is held as was last advised."""

    told: list[Shown] = field(default_factory=list)
    period_ns: int = 1_000_000_000
    speed_m: float = 0.0
    intrinsics = None
    skipped = 0

    def hear(self, shown: Shown, _: np.ndarray) -> None:
        self.told.append(shown)

    def frames(self, stopping: threading.Event) -> Iterator[Frame | None]:
        random = np.random.default_rng(4)
        for number in range(MOST_PICTURES):
            if stopping.is_set():
                return
            pose = self.pose(random)
            pose["x"] += self.speed_m * number * self.period_ns * 1e-9
            view = placed(charuco(), **pose)
            yield Frame(picture_of([view], noise=1.0, seed=number), (number + 1) * self.period_ns)

    def pose(self, random: np.random.Generator) -> dict[str, float]:
        """Where the board is held next: a hand is never exact."""
        if self.speed_m:
            return {"x": -0.2, "distance": 0.7}
        shown = self.told[-1] if self.told else None
        need = next((n for n in shown.needs if n.name == shown.next), None) if shown else None
        pose = {"distance": random.uniform(0.5, 0.65)}
        pose["tilt_deg"], pose["yaw_deg"] = random.uniform(-20, 20, 2).tolist()
        column, row = random.uniform(0.2, 0.8, 2).tolist()
        if need is not None and need.kind == "place":
            thirds = random.uniform(0.05, 0.28, 2)
            column = thirds[0] + (1 + ("right" in need.name) - ("left" in need.name)) / 3
            row = thirds[1] + (1 + ("lower" in need.name) - ("upper" in need.name)) / 3
        if need is not None and need.kind == "tilt":
            pose["yaw_deg"] = 35.0 * (("right" in need.name) - ("left" in need.name))
            pose["tilt_deg"] = -35.0 * (("lower" in need.name) - ("upper" in need.name))
        if need is not None and need.kind == "distance":
            column, row = 0.5, 0.5
            pose["distance"] = 0.3 if need.name == "near" else 0.9
        direction = CAMERA.directions(np.array([[column * CAMERA.width, row * CAMERA.height]]))[0]
        return pose | dict(zip("xy", (direction * pose["distance"]).tolist(), strict=True))

    def close(self) -> None:
        """Nothing is held open."""


@pytest.fixture
def open_person(monkeypatch: pytest.MonkeyPatch) -> Callable[[Person], Person]:
    def opened(person: Person) -> Person:
        monkeypatch.setattr(looking, "open_source", lambda *_, **__: person)
        return person

    return opened


def test_whoever_does_what_is_advised_gets_the_lens(
    open_person: Callable[[Person], Person], tmp_path: Path
) -> None:
    person = open_person(Person())
    wishes = Wishes(CONFIG, target_of(charuco()), out=tmp_path / "c1.yaml", ends_when_taken=True)
    result = Look(wishes, person.hear).run()
    assert result.missing == ""
    assert result.pictures < MOST_PICTURES
    assert result.lens is not None
    errors = result.lens.camera.parameters[:4] - CAMERA.parameters[:4]
    assert np.all(np.abs(errors) < 5 * result.lens.known.sigma[:4])
    assert result.lens.known.sigma[0] < 0.005 * CAMERA.fx
    assert read_camera_info(tmp_path / "c1.yaml").fx == pytest.approx(result.lens.camera.fx)
    assert {kind for shown in person.told for kind in kinds_of(shown)} == {
        "place", "tilt", "distance",
    }  # fmt: skip
    last = person.told[-1]
    assert last.over == f"it has ended; the lens is in {tmp_path / 'c1.yaml'}"
    assert last.lens is not None
    assert last.written
    assert [shown.number for shown in person.told] == sorted(shown.number for shown in person.told)


def kinds_of(shown: Shown) -> set[str]:
    """What the advice was about."""
    return {need.kind for need in shown.needs if need.name == shown.next}


@pytest.mark.parametrize("is_global", [False, True])
def test_a_board_that_moves_is_used_only_of_a_global_shutter(
    open_person: Callable[[Person], Person], tmp_path: Path, *, is_global: bool
) -> None:
    person = open_person(Person(period_ns=100_000_000, speed_m=0.3))
    wishes = Wishes(CONFIG, target_of(charuco()), out=tmp_path / "c1.yaml", is_global=is_global)
    look = Look(wishes, lambda shown, picture: stop_after(shown, picture))

    def stop_after(shown: Shown, picture: np.ndarray) -> None:
        person.hear(shown, picture)
        if shown.number == 6:
            look.stop()

    look.run()
    moving = [shown for shown in person.told if 2 <= shown.number <= 6 and not shown.over][:5]
    is_said = [shown.advice.startswith("hold the board still") for shown in moving]
    assert is_said == [not is_global] * 5
    # Of the first picture nothing is known of its motion.
    assert moving[-1].views == (6 if is_global else 1)
    speed_px = float(dict(moving[-1].facts)["moves"].split(" ")[0])
    assert speed_px == pytest.approx(0.3 * CAMERA.fx / 0.7, rel=0.1)


def test_a_password_is_told_nobody() -> None:
    config = CameraConfig("rtsp://user:secret@door/1")
    assert Look(Wishes(config, target_of(charuco())), lambda *_: None).name == "rtsp://door/1"
    folder = CameraConfig("dir://shots@home")
    assert Look(Wishes(folder, target_of(charuco())), lambda *_: None).name == "dir://shots@home"
