"""Where subscribers are declared, by a session that only notes it."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from trigpoint.contract.topics import CORRECTION
from trigpoint.zenoh import Datagrams, ZenohBus


@dataclass
class Session:
    """Stands for Zenoh's: `declared` is what subscribers listen to."""

    declared: list[str] = field(default_factory=list)

    def declare_subscriber(self, expression: str, _handler: object) -> SimpleNamespace:
        self.declared.append(expression)
        return SimpleNamespace(undeclare=lambda: self.declared.remove(expression))

    def close(self) -> None:
        pass


@pytest.mark.parametrize("reading", ["subscribe", "latest"])
def test_urgent_samples_are_had_as_datagrams_too(reading: str) -> None:
    main, beside = Session(), Session()
    datagrams = Datagrams(beside, is_beside=True)  # pyright: ignore[reportArgumentType]
    with ZenohBus(main, datagrams=datagrams) as bus:  # pyright: ignore[reportArgumentType]
        expression = CORRECTION.expression("lab")
        incoming = getattr(bus, reading)(CORRECTION, expression)
        assert main.declared == beside.declared == [expression]
        incoming.close()
        assert main.declared == beside.declared == []
