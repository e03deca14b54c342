"""What is not well for a while is renewed, and not for ever in a row."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from support.builders import eventually

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import BusError
from trigpoint.bus.keeper import Keeper, close_in_time

LOST_S = 0.05


class Patient:
    """Is well again after so many renewals, the first of which fail."""

    def __init__(self, *, needs: int, failing: int = 0) -> None:
        self.needs, self.failing, self.renewed, self.looks = needs, failing, 0, 0

    def is_well(self) -> bool:
        self.looks += 1
        return self.renewed >= self.needs

    def renew(self) -> None:
        self.renewed += 1
        if self.renewed <= self.failing:
            raise BusError("nobody answers")


@contextmanager
def kept(patient: Patient) -> Iterator[None]:
    keeper = Keeper("keeper of a test", patient.is_well, patient.renew, lost_s=LOST_S)
    try:
        yield
    finally:
        assert keeper.close(60.0)


def test_what_is_well_is_left_alone() -> None:
    patient = Patient(needs=0)
    with kept(patient):
        assert eventually(lambda: patient.looks > 10)
    assert patient.renewed == 0


def test_what_is_not_well_is_renewed_until_it_is_also_where_that_fails_at_first() -> None:
    patient = Patient(needs=3, failing=2)
    with kept(patient):
        assert eventually(lambda: patient.renewed == 3)
        looks = patient.looks
        assert eventually(lambda: patient.looks > looks + 5)
    assert patient.renewed == 3


def test_who_never_closes_is_left_behind(monkeypatch) -> None:
    left: list[str] = []
    monkeypatch.setattr(ENDING, "leave_behind", left.append)
    monkeypatch.setattr("trigpoint.bus.keeper._CLOSE_S", 0.05)
    may_end = threading.Event()
    close_in_time(may_end.wait, "a session")
    may_end.set()
    assert left == ["a session"]
