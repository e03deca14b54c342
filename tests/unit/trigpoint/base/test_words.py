"""How numbers and words are written for people."""

import pytest

from trigpoint.base.words import two_decimals


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0.00"), (1e-9, "<0.01"), (0.0049, "<0.01"), (0.006, "0.01"), (12.346, "12.35")],
)
def test_what_is_not_nothing_does_not_read_so(value: float, text: str) -> None:
    assert two_decimals(value) == text
