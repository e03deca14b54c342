"""How numbers and words are written for people."""

import pytest

from trigpoint.base.words import loss_words, plus_minus, two_decimals


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0.00"), (1e-9, "<0.01"), (0.0049, "<0.01"), (0.006, "0.01"), (12.346, "12.35")],
)
def test_what_is_not_nothing_does_not_read_so(value: float, text: str) -> None:
    assert two_decimals(value) == text


def test_losses_are_said_in_words() -> None:
    said = loss_words({"pictures": 1, "given_up": 3, "frozen": 0, "unreadable": 1})
    assert said == "1 picture, 3 pictures given up, 1 picture unreadable"
    assert (
        loss_words({"serial_frames_missing": 1, "unsent": 2}) == "1 serial frame missing, 2 unsent"
    )
    assert loss_words({"pictures": 0}) == ""
    assert loss_words({"file lab/tf_static": 1}) == "1 of lab/tf_static"


@pytest.mark.parametrize(
    ("sigma_m", "text"), [(0.0, "<0.1 cm"), (4e-4, "<0.1 cm"), (0.0084, "±0.8 cm"), (1.2, "±1.2 m")]
)
def test_a_sigma_is_never_said_to_be_none(sigma_m: float, text: str) -> None:
    assert plus_minus(sigma_m) == text
