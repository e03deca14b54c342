"""The ROS 2 package of our messages says what the recordings' schemas say."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from trigpoint.contract.cdr import definition

PACKAGE = Path(__file__).parents[3] / "tools" / "ros2" / "trigpoint_msgs"


def fields(text: str) -> list[str]:
    """The lines that are no comments."""
    lines = (line.partition("#")[0].split() for line in text.splitlines())
    return [" ".join(words) for words in lines if words]


def test_fields_are_those_of_the_recordings() -> None:
    whole = definition("trigpoint_msgs/msg/Sightings")
    head, *others = re.split(r"=+\nMSG: ", whole)
    ours = {"Sightings": head}
    for other in others:
        name, _, text = other.partition("\n")
        if name.startswith("trigpoint_msgs/"):
            ours[name.rpartition("/")[2]] = text
    written = {path.stem: path.read_text("utf-8") for path in (PACKAGE / "msg").glob("*.msg")}
    assert {name: fields(text) for name, text in written.items()} == {
        name: fields(text) for name, text in ours.items()
    }


@pytest.mark.parametrize("name", ["Sightings", "FaceSighting"])
def test_every_message_is_built_and_its_fields_explained(name: str) -> None:
    assert f'"msg/{name}.msg"' in (PACKAGE / "CMakeLists.txt").read_text("utf-8")
    lines = (PACKAGE / "msg" / f"{name}.msg").read_text("utf-8").splitlines()
    explained = [line for line in lines if line.startswith("#")]
    assert len(explained) >= 3


def test_package_names_what_it_needs() -> None:
    root = ET.parse(PACKAGE / "package.xml").getroot()
    assert root.findtext("name") == "trigpoint_msgs"
    assert {element.text for element in root.iter("depend")} == {"std_msgs"}
    assert [e.text for e in root.iter("member_of_group")] == ["rosidl_interface_packages"]
