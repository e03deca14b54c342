"""The attachment of a correction."""

from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.base.errors import MessageError
from trigpoint.contract.correction import CorrectionMark, decode_mark, encode_mark


@given(st.uuids(), st.integers(0, 2**64 - 1))
def test_mark_comes_back_as_it_was(map_id: UUID, sequence: int) -> None:
    mark = CorrectionMark(map_id, sequence)
    assert decode_mark(encode_mark(mark)) == mark


def test_mark_is_the_uuid_and_a_little_endian_number() -> None:
    mark = CorrectionMark(UUID("00112233-4455-6677-8899-aabbccddeeff"), 258)
    assert encode_mark(mark).hex() == "00112233445566778899aabbccddeeff" + "0201000000000000"


@pytest.mark.parametrize("length", [0, 16, 23, 25])
def test_attachment_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(MessageError, match=f"{length} bytes; it needs 24"):
        decode_mark(bytes(length))
