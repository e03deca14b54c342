"""The solver's process says that it is at work, and how long the next word may take."""

from trigpoint.fusion.solver_process import AtWork, LifeSign


class Desk:
    """A clock that is set by hand, and what was said."""

    def __init__(self) -> None:
        self.now_s, self.said = 100.0, list[AtWork]()
        self.sign = LifeSign(self.said.append, lambda: self.now_s)

    def give_after(self, seconds: float) -> None:
        self.now_s += seconds
        self.sign.give()


def test_sign_is_given_once_a_second_at_most() -> None:
    desk = Desk()
    for _ in range(9):
        desk.give_after(0.25)
    assert len(desk.said) == 3


def test_what_may_be_waited_for_grows_with_what_a_solution_took() -> None:
    desk = Desk()
    desk.give_after(1.0)
    desk.give_after(90.0)
    desk.give_after(1.0)
    usual, grown, after = (sign.within_s for sign in desk.said)
    assert (grown, after) == (900.0, 900.0)
    assert 60.0 < usual < grown
