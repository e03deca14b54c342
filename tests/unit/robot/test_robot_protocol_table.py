"""The table of protocols."""

import pytest

from trigpoint.errors import ConfigError
from trigpoint.robot.protocol import PROTOCOLS, known_protocols, protocol_class


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_every_row_opens(name: str) -> None:
    protocol = protocol_class(name)(robot="r1")
    assert isinstance(protocol.data_to_send(0), bytes)


@pytest.mark.parametrize("name", ["create2", "nonsense"])
def test_protocol_that_is_not_there_lists_those_that_are(name: str) -> None:
    with pytest.raises(ConfigError, match=f"no robot protocol «{name}».* trigpoint"):
        protocol_class(name)
    assert known_protocols() == ["trigpoint"]
