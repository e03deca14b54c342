"""Two runs of `calibrate` over one session."""

import os
import subprocess
import sys
from pathlib import Path

from support.fusion.drives import lab_plan, make_session, write_session


def test_two_runs_over_a_session_give_identical_bytes(tmp_path: Path) -> None:
    """In processes of their own, whose strings hash differently, with views that look alike."""
    recorded = write_session(make_session(lab_plan("checkerboard", picture_rate=1.0)), tmp_path)
    found = []
    for seed in ("1", "2"):
        out = tmp_path / seed
        call = "from trigpoint.cli import run; import sys; sys.exit(run(sys.argv[1:]))"
        subprocess.run(
            [sys.executable, "-c", call, "calibrate", str(recorded), "--out", str(out)],
            env=os.environ | {"PYTHONHASHSEED": seed},
            check=True,
            capture_output=True,
        )
        found.append((out / "network.json").read_bytes())
    assert b'"located"' in found[0]
    assert found[0] == found[1]
