"""Fusion with a map that is held: from the beginning, or by an operator's command."""

import json
from pathlib import Path

import pytest
from msgspec import Struct, structs
from msgspec.structs import replace
from support.builders import eventually
from support.fusion.drives import Session
from support.fusion.fixed_maps import fixed_network
from support.fusion.running_node import Running, running
from support.fusion.solvers import SlowSolver

from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import InputError
from trigpoint.contract import topics
from trigpoint.contract.correction import decode_mark
from trigpoint.fusion.checkpoint import CHECKPOINT, Checkpoint
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.holding import wish_of
from trigpoint.fusion.inputs import load_fixed
from trigpoint.fusion.live import coverage_thread
from trigpoint.fusion.pipeline import Inputs
from trigpoint.map.network import decode_network, load_network


class Solvers(Struct):
    """Makes solvers, and counts them."""

    made: int = 0

    def __call__(self, inputs: Inputs) -> SlowSolver:
        self.made += 1
        return SlowSolver(inputs)


def is_fixed(run: Running) -> bool:
    reply = run.reply("fusion/learn")
    return not reply.error and json.loads(reply.payload)["map"] == "fixed"


def not_learning(inputs: Inputs) -> Inputs:
    """The same with learn = false."""
    fusion = structs.replace(inputs.site.fusion, learn=False)
    return replace(inputs, site=structs.replace(inputs.site, fusion=fusion))


def test_fixed_map_corrects_without_a_solver_and_writes_nothing(
    charuco: Session, charuco_results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coverage_thread, "PERIOD_S", 0.2)
    solvers, fixed = Solvers(), fixed_network(charuco_results)
    inputs = not_learning(charuco.inputs)
    with running(inputs, tmp_path, solver=solvers, fixed=fixed) as run:
        corrections = run.listen(topics.CORRECTION)
        grids = run.listen(topics.COVERAGE_GRID)
        run.feed(charuco.messages[:300])
        assert eventually(lambda: corrections.depth > 5)
        assert eventually(lambda: grids.depth > 0, timeout_s=60.0)
        map_id = run.ask("fusion/map")["map_id"]
        sample = corrections.take(0.0)
        assert sample is not None
        assert str(decode_mark(sample.attachment).map_id) == map_id
        assert run.ask("fusion/learn") == {"learn": False, "map": "fixed"}
        assert "is not given up" in run.reply("fusion/reset").error
        answered = run.ask("fusion/network")
        assert run.node.health.report().values["map"] == "fixed"
    run.fusion.finish()
    assert solvers.made == 0
    assert map_id == answered["map_id"] == charuco_results.network.map_id
    assert list(tmp_path.iterdir()) == []


def test_operator_holds_a_map_and_learns_it_again(charuco: Session, tmp_path: Path) -> None:
    solvers = Solvers()
    middle = len(charuco.messages) // 2
    with running(charuco.inputs, tmp_path, solver=solvers) as run:
        run.feed(charuco.messages[:100])
        run.feed(charuco.messages[100:middle])
        before = run.ask("fusion/map")
        assert run.ask("fusion/learn") == {"learn": True, "map": "learnt"}
        assert run.ask("fusion/learn", {"learn": False})["learn"] is False
        assert eventually(lambda: is_fixed(run), timeout_s=120.0)
        held = (tmp_path / "network.json").read_bytes()
        size = (tmp_path / CHECKPOINT).stat().st_size
        corrections = run.listen(topics.CORRECTION)
        run.feed(charuco.messages[middle:-150])
        assert eventually(lambda: corrections.depth > 3)
        assert run.ask("fusion/map") == before
        assert run.ask("fusion/network")["cameras"] == json.loads(held)["cameras"]
        assert (tmp_path / CHECKPOINT).stat().st_size == size
        assert run.ask("fusion/learn", {"learn": True})["learn"] is True
        assert eventually(
            lambda: run.ask("fusion/learn") == {"learn": True, "map": "learnt"}, timeout_s=120.0
        )
        run.feed(charuco.messages[-150:])
        assert run.ask("fusion/map") == before
        assert run.node.health.report().values["map"] == ""
    run.fusion.finish()
    assert solvers.made == 2
    counts = [decode_network(held), load_network(tmp_path)]
    assert counts[0].until_ns is not None
    assert counts[1].until_ns is not None
    assert counts[1].until_ns > counts[0].until_ns


def test_checkpoint_of_a_learnt_map_is_held_where_the_site_learns_nothing(
    charuco: Session, tmp_path: Path
) -> None:
    with running(charuco.inputs, tmp_path, solver=Solvers()) as run:
        run.feed(charuco.messages[:400])
        before = run.ask("fusion/map")
    run.fusion.finish()
    solvers = Solvers()
    with running(not_learning(charuco.inputs), tmp_path, solver=solvers) as run:
        assert eventually(lambda: is_fixed(run), timeout_s=120.0)
        assert run.ask("fusion/map") == before
    run.fusion.finish()
    assert solvers.made == 1  # which works the map out of it, and ends


def test_nothing_is_held_before_a_camera_is_located(charuco: Session, tmp_path: Path) -> None:
    with running(charuco.inputs, tmp_path, solver=Solvers()) as run:
        assert "no camera is located yet" in run.reply("fusion/learn", {"learn": False}).error
        assert run.ask("fusion/learn") == {"learn": True, "map": "learnt"}


def test_without_a_network_there_is_nothing_to_hold(
    charuco: Session, charuco_results: Results, tmp_path: Path
) -> None:
    inputs = not_learning(charuco.inputs)
    with pytest.raises(InputError, match="no network to hold fixed: give --network"):
        load_fixed(inputs, network=None, folder=tmp_path)
    Checkpoint(tmp_path / CHECKPOINT, ManualClock()).close()  # which has nothing in it
    with pytest.raises(InputError, match="no network to hold fixed"):
        load_fixed(inputs, network=None, folder=tmp_path)
    assert load_fixed(charuco.inputs, network=None, folder=tmp_path) is None
    charuco_results.save(tmp_path)
    known = replace(inputs, known=fixed_network(charuco_results).known)
    fixed = load_fixed(known, network=tmp_path, folder=tmp_path)
    assert fixed is not None
    assert fixed.network == charuco_results.network


@pytest.mark.parametrize("request_", [b"no", b"[]", b"{}", b'{"learn": 1}', b'{"lern": true}'])
def test_request_that_is_none_is_refused(request_: bytes) -> None:
    with pytest.raises(InputError, match=r"fusion/learn: .*send"):
        wish_of(request_)


def test_request_is_taken_as_it_says() -> None:
    assert wish_of(b"") is None
    assert wish_of(b'{"learn": false}') is False
    assert wish_of(b'{"learn": true}') is True
