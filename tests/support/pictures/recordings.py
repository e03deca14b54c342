"""A recording of pictures as another program writes it, and parts that it is made from."""

import json
from pathlib import Path
from typing import Any

import cv2
from mcap.writer import Writer
from support.pictures.boards import charuco, picture_of, placed

from trigpoint.contract import cdr
from trigpoint.contract.messages import PICTURE, Picture

GREY = picture_of([placed(charuco(), distance=0.8, tilt_deg=15)])
PNG = cv2.imencode(".png", GREY)[1].tobytes()
SOUND = cdr.encode(Picture(0, "", "png", PNG))
TOPIC = "/c1/image_raw/compressed"


def write(
    file: Path,
    payloads: list[bytes],
    *,
    first_s: int = 1000,
    topic: str = TOPIC,
    encoding: str = "cdr",
    definition: bytes = cdr.definition(PICTURE).encode(),
    **options: Any,
) -> Path:
    """A file of pictures, a second apart."""
    writer = Writer(str(file), **options)
    writer.start(profile="ros2", library="theirs")
    schema = writer.register_schema(PICTURE, "ros2msg", definition)
    channel = writer.register_channel(topic, encoding, schema)
    for number, payload in enumerate(payloads):
        time_ns = (first_s + number) * 10**9
        writer.add_message(channel, time_ns, payload, time_ns)
    writer.finish()
    return file


def listed(folder: Path, files: list[str]) -> Path:
    """A folder's metadata.yaml, as rosbag2 has it."""
    information = {"relative_file_paths": files, "compression_mode": "", "version": 9}
    text = json.dumps({"rosbag2_bagfile_information": information})
    (folder / "metadata.yaml").write_text(text)
    return folder
