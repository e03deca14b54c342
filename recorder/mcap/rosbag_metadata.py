"""metadata.yaml beside a recording: what makes its folder a bag that `ros2 bag` opens."""

from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from msgspec import Struct, field

from trigpoint.base.disk import replace_file
from trigpoint.base.errors import RecordingError
from trigpoint.contract import cdr
from trigpoint.contract.topics import topic_of

from .channels import quality_of_service

FILE = "metadata.yaml"
BAGS = (".mcap", ".db3", ".bag")
"""What the files of sessions and bags end in."""
_VERSION = 9  # rosbag2's of Jazzy


class PartFacts(Struct, frozen=True):
    """One file of the bag: its name, first and last log time, messages of each key; `types`: those
    of keys that are not in the contract, or not of its type."""

    name: str
    times_ns: tuple[int, int]
    counts: Mapping[str, int]
    types: Mapping[str, str] = field(default_factory=dict)


def is_bag(path: Path) -> bool:
    """Whether a path is the file of a bag or session, packed or not, or a folder with one."""
    files = path.iterdir() if path.is_dir() else [path]
    return any(file.with_suffix("").suffix in BAGS or file.suffix in BAGS for file in files)


def write_metadata(folder: Path, parts: Sequence[PartFacts]) -> None:
    """Write the file anew, in one step."""
    replace_file(folder / FILE, metadata_text(parts).encode())


def listed_files(folder: Path) -> list[Path]:
    """The files that a folder's metadata.yaml lists, in its order, packed or unpacked by hand; none
    where there is none.

    Raises RecordingError where it cannot be read.
    """
    file = folder / FILE
    if not file.exists():
        return []
    names = _information(file)["relative_file_paths"]
    # Bags of the first versions of rosbag2 name their own folder too.
    return [_as_it_is(folder / Path(str(name)).name) for name in names]


def _as_it_is(listed: Path) -> Path:
    others = (listed.with_suffix(""), listed.with_name(f"{listed.name}.zstd"))
    return next((file for file in (listed, *others) if file.is_file()), listed)


def packs_messages(folder: Path, name: str = "") -> bool:
    """Whether the messages of the bag in a folder are packed one by one, and its files, of which a
    metadata.yaml tells, include the one of that name, if any."""
    if not (folder / FILE).exists():
        return False
    try:
        information = _information(folder / FILE)
    except RecordingError:
        return False  # `listed_files` says why
    is_listed = not name or any(
        Path(str(n)).name == name for n in information["relative_file_paths"]
    )
    return is_listed and str(information.get("compression_mode")).lower() == "message"


def _information(file: Path) -> dict[str, Any]:
    """What a metadata.yaml says, with its list of files."""
    from ruamel.yaml import YAML, YAMLError  # whoever reads a session alone has no such file

    try:
        said = YAML(typ="safe").load(file.read_bytes()) or {}
        information = said["rosbag2_bagfile_information"]
        list(information["relative_file_paths"])
    except (YAMLError, OSError, LookupError, TypeError, UnicodeDecodeError) as reason:
        text = " ".join(str(reason).split())
        raise RecordingError(
            f"{file}: its relative_file_paths cannot be read ({text}); run `ros2 bag reindex`"
        ) from None
    return information


def metadata_text(parts: Sequence[PartFacts]) -> str:
    """The file's text, as rosbag2 of Jazzy writes it."""
    from ruamel.yaml import YAML

    counts: dict[str, int] = {}
    for part in parts:
        for key, count in part.counts.items():
            counts[key] = counts.get(key, 0) + count
    types = {key: name for part in parts for key, name in part.types.items()}
    started = [part.times_ns[0] for part in parts if part.counts]
    start_ns = min(started, default=0)
    end_ns = max((part.times_ns[1] for part in parts if part.counts), default=0)
    information = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(counts.values()),
        "topics_with_message_count": [
            _topic(key, count, types.get(key, "")) for key, count in counts.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [_file(part) for part in parts],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    text = StringIO()
    YAML().dump({"rosbag2_bagfile_information": information}, text)
    return text.getvalue()


def _topic(key: str, count: int, type_name: str) -> dict[str, object]:
    from ruamel.yaml.scalarstring import LiteralScalarString

    topic = topic_of(key)
    name = type_name or (topic.type_name if topic else "std_msgs/msg/UInt8MultiArray")
    metadata = {
        "name": "/" + key,
        "type": name,
        "serialization_format": "cdr",
        "offered_qos_profiles": LiteralScalarString(quality_of_service(topic)) if topic else "",
        "type_description_hash": cdr.type_hash(name),
    }
    return {"topic_metadata": metadata, "message_count": count}


def _file(part: PartFacts) -> dict[str, object]:
    start_ns, end_ns = part.times_ns
    return {
        "path": part.name,
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": end_ns - start_ns},
        "message_count": sum(part.counts.values()),
    }
