from pathlib import Path

import pytest

from trigpoint.base import errors
from trigpoint.base.errors import InputError, OperationError, TrigpointError, read_text, writing


def every_error() -> list[type[TrigpointError]]:
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    return [kind for kind in kinds if issubclass(kind, TrigpointError)]


def test_every_error_has_its_place_in_the_drawn_tree() -> None:
    assert errors.__doc__ is not None
    for kind in every_error():
        assert kind.__name__ in errors.__doc__
        expected = 2 if issubclass(kind, InputError) else 1
        assert kind.exit_status == expected
        assert kind is TrigpointError or issubclass(kind, InputError | OperationError)


def test_text_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("ü", encoding="utf-8")
    assert read_text(path, "file", InputError) == "ü"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_text_as_windows_writes_it_is_the_same(tmp_path: Path, encoding: str, end: str) -> None:
    path = tmp_path / "a.txt"
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    path.write_bytes((mark + f"a = 1{end}# Tür{end}").encode(encoding))
    assert read_text(path, "file", InputError) == "a = 1\n# Tür\n"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("a\n# Tür\n".encode("latin-1"), "a.txt:2: this line is not UTF-8; save the file as UTF-8"),
        (b"\x89PNG\r\n\x1a\n\0\0", "a.txt: this is not text, so it is no file; check the path"),
    ],
)
def test_what_is_no_utf8_is_said_by_its_line_and_what_is_no_text(
    tmp_path: Path, data: bytes, said: str
) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_text(path, "file", InputError)
    assert str(caught.value).endswith(said)


def test_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the site file cannot be read"):
        read_text(tmp_path, "site file", InputError)


def test_file_that_cannot_be_written_is_one_line_that_says_where(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "a.txt"
    with pytest.raises(OperationError, match="cannot be written") as caught, writing(path):
        path.write_text("a")
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
