"""The table of protocols."""

import pytest

from trigpoint.base.errors import ConfigError
from trigpoint.robot.line.protocol import (
    PROTOCOLS,
    Setup,
    known_protocols,
    make_protocol,
    protocol_class,
)
from trigpoint.site.config import RobotConfig, WheelConfig


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_every_row_opens(name: str) -> None:
    config = RobotConfig(port="x", protocol=name, wheels=WheelConfig(0.1, 0.3, 1000))
    protocol = make_protocol(Setup("r1", config, 1))
    assert isinstance(protocol.data_to_send(0), bytes)
    assert protocol.traits.takes


@pytest.mark.parametrize("name", ["create3", "nonsense"])
def test_protocol_that_is_not_there_lists_those_that_are(name: str) -> None:
    with pytest.raises(ConfigError, match=f"no robot protocol «{name}».* trigpoint"):
        protocol_class(name)
    assert known_protocols() == sorted([*PROTOCOLS, "ros2"])
