"""How a packed bag is unpacked."""

import io

import zstandard

from trigpoint.recorder.mcap import packed


class _Pieces(io.BytesIO):
    """Keeps the sizes of what is written, nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.sizes: list[int] = []

    def write(self, piece: object) -> int:
        self.sizes.append(len(memoryview(piece)))  # pyright: ignore[reportArgumentType]
        return self.sizes[-1]


def test_a_small_file_that_unpacks_to_much_is_held_in_memory_piece_by_piece() -> None:
    source, pieces = io.BytesIO(zstandard.compress(bytes(1 << 28))), _Pieces()
    assert packed._unpack(source, pieces)  # pyright: ignore[reportPrivateUsage]
    assert sum(pieces.sizes) == 1 << 28
    assert max(pieces.sizes) <= 1 << 26
