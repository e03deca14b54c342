"""Building the compiled core."""

import pytest

from trigpoint.native import build


def test_a_compiler_that_does_not_end_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "_MOST_SECONDS", 0.1)
    with pytest.raises(build.BuildError, match=r"took longer than .* build again"):
        build._run(["sleep", "5"])  # pyright: ignore[reportPrivateUsage]
