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
