"""Questions with answers that are checked: from a person, from a file, or the defaults."""

from collections.abc import Callable
from typing import TextIO

from msgspec import Struct

from trigpoint.base.errors import InputError

_MOST_TRIES = 5


class Question(Struct, frozen=True):
    """`check` makes an answer what is gone on with, or raises InputError that says what is wrong
    with it."""

    text: str
    default: str
    check: Callable[[str], str] = str


class Questions:
    """Asks on `screen`, and reads one line an answer from `answers`; None: takes every default."""

    def __init__(self, screen: TextIO, answers: TextIO | None) -> None:
        self._screen, self._answers = screen, answers

    def ask(self, question: Question) -> str:
        """The checked answer. Raises InputError where answers end, or none of five is right."""
        for _ in range(_MOST_TRIES):
            self._screen.write(f"{question.text} [{question.default}] ")
            self._screen.flush()
            answer = self._answer(question) or question.default
            try:
                return question.check(answer)
            except InputError as reason:
                if self._answers is None:
                    raise
                self._screen.write(f"  {reason}\n")
        raise InputError(f"no answer to «{question.text}» was right; begin again")

    def confirm(self, text: str, *, default: bool) -> bool:
        return self.ask(Question(f"{text} (y/n)", "y" if default else "n", _yes_or_no)) == "y"

    def _answer(self, question: Question) -> str:
        if self._answers is None:
            self._screen.write(f"{question.default}\n")
            return ""
        line = self._answers.readline()
        if not line:
            self._screen.write("\n")
            raise InputError(
                f"the answers ended at «{question.text}»; give one a line on standard input, or "
                "--yes for the defaults"
            )
        if not self._answers.isatty():
            self._screen.write(line if line.endswith("\n") else f"{line}\n")
        return line.strip()


def _yes_or_no(answer: str) -> str:
    if answer.lower() not in ("y", "yes", "n", "no"):
        raise InputError(f"«{answer}» is neither y nor n")
    return answer[0].lower()
