"""What a restart goes on from: which messages are stored, and which of them are used again."""

from pathlib import Path

import pytest
from support.builders import make_site

from trigpoint.base.clock import ManualClock, SystemClock, to_ns
from trigpoint.base.errors import OperationError
from trigpoint.contract import cdr
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.fusion import map_storage
from trigpoint.fusion.checkpoint import PAST, full_files
from trigpoint.fusion.inbox import INPUT_TOPICS, Input
from trigpoint.fusion.intake.admission import AHEAD_NS
from trigpoint.fusion.map_storage import MapStorage, Stored
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.model.odometry import MOST_STANDING
from trigpoint.fusion.model.past import Past
from trigpoint.fusion.model.readings import Readings
from trigpoint.geometry import Pose

SITE = make_site()


def opened(folder: Path, *, known: tuple[str, ...] = ("r1", "c1")) -> MapStorage:
    def knows(key: str) -> bool:
        return any(f"/{name}/" in key for name in known)

    return MapStorage(folder, SITE, SystemClock(), knows=knows)


def store(storage: MapStorage, node: str, *messages: Input) -> None:
    for message in messages:
        key = INPUT_TOPICS[type(message)].key(SITE.name, node)
        assert storage.store(key, cdr.encode(message), message) == 0


def read(folder: Path, **known: tuple[str, ...]) -> list[Stored]:
    """What a restart uses."""
    storage = opened(folder, **known)
    found = [stored for some in storage.read(64) for _, stored in some]
    storage.close()
    return found


def stamps_of(found: list[Stored]) -> list[int]:
    """The stamps of all that is used, in order."""
    stamps = [s.stamps_ns.tolist() if isinstance(s, Readings) else [s.stamp_ns] for s in found]
    return [stamp_ns for some in stamps for stamp_ns in some]


def odometry(stamp_ns: int, x: float = 0.0) -> Odometry:
    return Odometry(stamp_ns, "r1/odom", "r1/base", Pose.planar(x, 0.0, 0.0))


def test_what_was_stored_is_used_again_in_order(tmp_path: Path) -> None:
    storage, seen = opened(tmp_path), Sightings(2, "c1/optical", 640, 480, ())
    store(storage, "r1", odometry(1), odometry(2, 0.1))
    store(storage, "c1", seen)
    storage.close()
    readings, sightings = read(tmp_path)
    assert isinstance(readings, Readings)
    assert isinstance(sightings, Sightings)
    assert readings.stamps_ns.tolist() == [1, 2]
    assert readings.odom_from_base.translation[:, 0].tolist() == [0.0, 0.1]
    assert sightings.stamp_ns == 2


def test_a_robot_that_the_site_file_lost_is_left_out(tmp_path: Path) -> None:
    storage = opened(tmp_path)
    store(storage, "r1", odometry(1))
    storage.close()
    assert read(tmp_path, known=("c1",)) == []


def test_a_checkpoint_of_another_site_is_refused(tmp_path: Path) -> None:
    storage = opened(tmp_path)
    storage.store("hall/robot/r1/odom", cdr.encode(odometry(1)), odometry(1))
    storage.close()
    with pytest.raises(OperationError, match="another site"):
        read(tmp_path)


@pytest.mark.parametrize("is_damaged", [False, True])
def test_what_cannot_be_of_its_time_or_not_be_read_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, *, is_damaged: bool
) -> None:
    storage, key = opened(tmp_path), INPUT_TOPICS[Odometry].key(SITE.name, "r1")
    ahead = odometry(SystemClock().now_ns() + 2 * AHEAD_NS, 0.1)
    payload = cdr.encode(ahead)[: -1 if is_damaged else None]
    store(storage, "r1", odometry(1))
    storage.store(key, payload, ahead)
    store(storage, "r1", odometry(2))
    storage.close()
    assert stamps_of(read(tmp_path)) == [1, 2]
    assert "left out" in caplog.text


def test_of_a_standstill_little_is_stored_and_its_end_too(tmp_path: Path) -> None:
    storage = opened(tmp_path)
    store(storage, "r1", *(odometry(to_ns(0.1 * i)) for i in range(1, 3 * MOST_STANDING)))
    storage.close()
    found = stamps_of(read(tmp_path))
    assert MOST_STANDING < len(found) < MOST_STANDING + 20
    assert found[-1] == to_ns(0.1 * (3 * MOST_STANDING - 1))


def test_a_new_map_begins_empty_and_the_old_one_is_kept(tmp_path: Path) -> None:
    storage = opened(tmp_path)
    store(storage, "r1", odometry(1))
    storage.restart()
    store(storage, "r1", odometry(7))
    storage.close()
    assert stamps_of(read(tmp_path)) == [7]
    assert (tmp_path / "checkpoint.1.bin").exists()


def test_a_file_stays_as_long_as_any_robot_needs_it(tmp_path: Path) -> None:
    """Of r2, which was not seen for long, sightings are kept that are older than r1's past."""
    storage = MapStorage(tmp_path, SITE, SystemClock(), knows=lambda _: True, most=10)
    store(storage, "r1", *(odometry(to_ns(second), second) for second in range(1, 35)))
    names = [path.name for path in full_files(tmp_path)]
    assert names == [f"checkpoint-00000{number}.bin" for number in (1, 2, 3)]

    def settled(r1_s: float, r2_s: float) -> list[str]:
        since_ns = {"r1": to_ns(r1_s), "r2": to_ns(r2_s)}
        storage.settle(Past(KnownCameras.none(), since_ns, None, 0, {}))
        return [path.name for path in full_files(tmp_path)]

    assert settled(30.0, 5.0) == names
    assert settled(32.0, 25.0) == names[2:]
    storage.close()
    assert storage.trouble == ""


def test_a_past_that_the_disk_did_not_take_is_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = ManualClock(to_ns(100.0))
    storage = MapStorage(tmp_path, SITE, clock, knows=lambda _: True, most=10)
    store(storage, "r1", *(odometry(to_ns(second), second) for second in range(1, 25)))
    past = Past(KnownCameras.none(), {"r1": to_ns(24.0)}, None, 0, {})

    def full(*_: object) -> None:
        raise OSError(28, "no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(map_storage, "save_past", full)
        for _ in range(100):
            storage.settle(past)
    assert caplog.text.count("no space left on device") == 1
    assert len(full_files(tmp_path)) == 2
    storage.settle(past)
    assert len(full_files(tmp_path)) == 2
    clock.advance(31.0)
    storage.settle(past)
    assert (tmp_path / PAST).exists()
    assert full_files(tmp_path) == []
    storage.close()
