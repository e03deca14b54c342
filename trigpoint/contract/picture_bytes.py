"""Whether bytes are a whole picture, as far as can be told without decoding it."""

_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
_FILL = 0xFF  # any number of it may stand before a marker's number
_LEAST_SCAN_HEADER = 8  # bytes, of one component
_PNG_START, _PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"  # the end with its checksum
# What the drivers that say «jpeg» or «png» send: some say one and send another.
_STARTS = (_JPEG_START, _PNG_START, b"RIFF", b"BM", b"II*\0", b"MM\0*")


def is_cut_short(data: bytes) -> bool:
    """Whether a JPEG or PNG lacks its end, or what is needed before it. (In a JPEG's scan neither
    marker can occur.)"""
    if data.startswith(_JPEG_START):
        begins = _scan_begins(data)
        return begins < 0 or data.rfind(_JPEG_END) <= max(data.rfind(_JPEG_SCAN), begins)
    return data.startswith(_PNG_START) and _PNG_END not in data


def _scan_begins(data: bytes) -> int:
    """Where the first scan of a JPEG begins, behind segments of which each says its length; -1
    where they end before (ITU T.81, B.1.1)."""
    at = len(_JPEG_START)
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 3:
        marker, size = data[at : at + 2], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == _JPEG_END:
            return -1
        at += 1 if marker[1] == _FILL else 2 + size
        if marker == _JPEG_SCAN:
            return at if size >= _LEAST_SCAN_HEADER and at <= len(data) else -1
    return -1


def fault_in_compressed(data: bytes, form: str) -> str:
    """What is wrong with a message's picture that is said to be «jpeg», «png» or else; "" where
    nothing is, or nothing can be told."""
    if not data:
        return "holds an empty picture"
    if is_cut_short(data):
        return "holds a picture that is cut short"
    words = form.lower()
    is_known = ("jpeg" in words or "jpg" in words or "png" in words) and "depth" not in words
    return "holds no picture" if is_known and not data.startswith(_STARTS) else ""


def fault_in_raw(size: int, width: int, height: int, encoding: str) -> str:
    """The same of `size` bytes of plain pixels, of which each has one byte at least."""
    if not width * height:
        return "holds an empty picture"
    if not encoding:
        return "holds a picture without an encoding"
    return "holds too few bytes for its pixels" if size < width * height else ""
