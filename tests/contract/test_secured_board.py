"""The board over mutual TLS: a viewer's certificate shows everything, and lets nothing out."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.builders import eventually
from support.site.board_desk import served_board
from support.site.board_site import Truth
from support.site.secured import SecuredSite

from trigpoint.contract import topics
from trigpoint.contract.access import Kind
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import command_key
from trigpoint.zenoh import ZenohBus, open_router


@pytest.mark.parametrize("person", [Kind.VIEWER, Kind.OPERATOR])
def test_a_person_sees_the_site_and_only_an_operators_command_arrives(
    person: Kind, tmp_path: Path, free_port: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    site = SecuredSite(tmp_path, free_port())
    for key in (tmp_path / "secure").glob("*.key"):
        if key.stem.startswith(("operator", "viewer")) and not key.stem.startswith(person):
            key.unlink()
    truth, asked = Truth(2, 2), []
    with (
        open_router(site.listening),
        # As from another machine: on this one, programs meet unchecked.
        ZenohBus(site.session(Kind.FUSION, "fusion")) as fusion,
        # Shown whatever the command would say: the rules of the bus hold where the page does not.
        served_board(site.connecting, monkeypatch, is_operator=True, opens_bus=True) as desk,
    ):
        fusion.serve(command_key("lab", "fusion/reset"), lambda _: asked.append(1) or b"{}")
        sender = fusion.publisher(topics.CAMERA_POSE, topics.CAMERA_POSE.key("lab", "c1"))
        estimate = PoseEstimate(0, "map", truth.camera(0), 1e-4 * np.eye(6))

        def is_located() -> bool:
            sender.put(encode(estimate))
            whole = json.loads(desk.ask(f"/past?at={time.time():.1f}").body)["all"]
            return whole["camera/c1"]["state"] == "located"

        assert eventually(is_located)
        whole = json.loads(desk.ask(f"/past?at={time.time():.1f}").body)["all"]
        assert np.allclose(whole["camera/c1"]["at"], truth.camera(0).translation, atol=1e-3)
        own = {"Origin": f"http://127.0.0.1:{desk.port}"}
        answer = desk.ask("/command/fusion/reset", "POST", **own)
        assert answer.status == (200 if person is Kind.OPERATOR else 503)
    assert asked == ([1] if person is Kind.OPERATOR else [])
