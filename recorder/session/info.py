"""What is in a recording: keys, types, rates, gaps, losses, breaks of sequence, clock jumps."""

import json
from collections import Counter

from msgspec import Struct, field, to_builtins

from trigpoint.base.clock import to_seconds
from trigpoint.recorder.mcap.channels import attached_to
from trigpoint.recorder.mcap.file import McapIndex
from trigpoint.recorder.mcap.packed import unpacked

from .files import CLOCK, LOSSES, repeated_keys
from .recording import Recording, key_of


class KeyInfo(Struct):
    """One key: `rate_hz` from its first to its last message, `longest_gap_s` between two of them,
    `lost` by the recorder's own count, `sequence_breaks` where messages are missing in the file."""

    type: str
    messages: int = 0
    bytes: int = 0
    rate_hz: float = 0.0
    longest_gap_s: float = 0.0
    lost: int = 0
    sequence_breaks: int = 0
    attachments: int = 0


class SessionInfo(Struct):
    """A whole session; times are log times."""

    files: list[str]
    problem: str
    start_ns: int
    end_ns: int
    duration_s: float
    bytes: int
    chunks: int
    keys: dict[str, KeyInfo] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    clock_jumps: list[dict[str, float]] = field(default_factory=list)
    log_time_steps_back: int = 0


def session_info(recording: Recording) -> SessionInfo:
    """Read every message's head."""
    info = SessionInfo(
        files=[str(part.path) for part in recording.parts],
        problem=recording.problem,
        start_ns=recording.start_ns,
        end_ns=recording.end_ns,
        duration_s=to_seconds(recording.end_ns - recording.start_ns),
        bytes=sum(unpacked(part.path).stat().st_size for part in recording.parts),
        chunks=sum(len(part.chunks) for part in recording.parts),
        attachments={name: len(data) for name, data in recording.attachments.items()},
    )
    tracks: dict[str, _Track] = {}
    for number, part in enumerate(recording.parts):
        _read_part(recording, part, tracks, info, repeated_keys(part) if number else set())
    losses = recording.notes.get(LOSSES, {})
    for key, track in tracks.items():
        track.info.lost = int(losses.get(key, "0"))
        span_s = to_seconds(track.last_ns - track.first_ns)
        track.info.rate_hz = (track.info.messages - 1) / span_s if span_s > 0 else 0.0
        info.keys[key] = track.info
    for key in losses.keys() - tracks.keys():
        info.keys[key] = KeyInfo(type="", lost=int(losses[key]))
    for log_ns, seconds in recording.notes.get(CLOCK, {}).items():
        at_s = to_seconds(int(log_ns) - info.start_ns)
        info.clock_jumps.append({"at_s": round(at_s, 3), "seconds": json.loads(seconds)})
    return info


def info_json(info: SessionInfo) -> str:
    return json.dumps(to_builtins(info), indent=1)


def info_lines(info: SessionInfo) -> list[str]:
    """The same for people, without the table of keys."""
    lines = [
        f"{', '.join(info.files)}: {info.duration_s:.1f} s, {info.bytes / 1e6:.1f} MB, "
        f"{info.chunks} chunks, {sum(key.messages for key in info.keys.values())} messages"
    ]
    if info.problem:
        lines.append(f"not whole: {info.problem}")
    lines += [
        f"clock set by {jump['seconds']:+.3f} s, {jump['at_s']:.1f} s after the start"
        for jump in info.clock_jumps
    ]
    if info.log_time_steps_back:
        lines.append(f"log time steps back {info.log_time_steps_back} times")
    if info.attachments:
        lines.append("attached: " + ", ".join(info.attachments))
    return lines


class _Track(Struct):
    info: KeyInfo
    first_ns: int
    last_ns: int


def _read_part(
    recording: Recording,
    part: McapIndex,
    tracks: dict[str, _Track],
    info: SessionInfo,
    repeated: set[str],
) -> None:
    keys = {number: key_of(part, number) for number in part.channels}
    attached: Counter[str] = Counter()
    sequences: dict[int, int] = {}  # each file counts anew
    last_ns = 0
    for message in recording.messages(part, set(keys)):
        key = keys[message.channel]
        info.log_time_steps_back += message.log_ns < last_ns
        last_ns = message.log_ns
        if owner := attached_to(key):
            attached[owner] += 1
            continue
        track = tracks.get(key)
        if track is None:
            type_name = part.type_of(message.channel)
            track = tracks[key] = _Track(KeyInfo(type_name), message.log_ns, message.log_ns)
        if key in repeated:
            repeated.discard(key)
        else:
            _count(track, message.log_ns, len(message.payload))
        before = sequences.get(message.channel)
        if before is not None:
            is_counted = message.sequence or before  # drivers that do not count say 0
            track.info.sequence_breaks += bool(is_counted and message.sequence != before + 1)
        sequences[message.channel] = message.sequence
    for key, count in attached.items():
        if key in tracks:
            tracks[key].info.attachments += count


def _count(track: _Track, log_ns: int, size: int) -> None:
    track.info.messages += 1
    track.info.bytes += size
    gap_s = to_seconds(log_ns - track.last_ns)
    track.info.longest_gap_s = max(gap_s, track.info.longest_gap_s)
    track.last_ns = log_ns
