"""Whether bytes are a whole picture, as far as can be told without decoding it."""

_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
_PNG_START, _PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"  # the end with its checksum
# What the drivers that say «jpeg» or «png» send: some say one and send another.
_STARTS = (_JPEG_START, _PNG_START, b"RIFF", b"BM", b"II*\0", b"MM\0*")


def is_cut_short(data: bytes) -> bool:
    """Whether a JPEG or PNG lacks its end. (In a JPEG's scan neither marker can occur.)"""
    if data.startswith(_JPEG_START):
        return data.rfind(_JPEG_END) < max(data.rfind(_JPEG_SCAN), 0)
    return data.startswith(_PNG_START) and _PNG_END not in data


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
