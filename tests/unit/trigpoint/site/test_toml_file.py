import pytest
from msgspec import Struct

from trigpoint.base.errors import ConfigError, TargetError
from trigpoint.site.target import parse_target
from trigpoint.site.toml_file import parse_toml


class Inner(Struct, frozen=True):
    number: int = 1
    word: str | None = None


class Outer(Struct, frozen=True):
    name: str
    inner: Inner = Inner()
    table: dict[str, Inner] = {}
    row: tuple[Inner, ...] = ()

    def __post_init__(self) -> None:
        if self.name == "forbidden":
            raise ValueError("that name is taken; choose another")


def parse(text: str) -> Outer:
    return parse_toml(text, Outer, "f.toml", ConfigError)


def test_nested_tables_become_structs() -> None:
    text = 'name = "a"\ninner.number = 2\n[table.x]\nword = "w"\n[[row]]\n[[row]]\nnumber = 7\n'
    assert parse(text) == Outer("a", Inner(2), {"x": Inner(word="w")}, (Inner(), Inner(7)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('name = "a"\nnmae = 1', "f.toml:2: nmae is not a known key; did you mean «name»?"),
        ("inner.number = 1", "f.toml: needs the key «name»; add it"),
        (
            'name = "a"\n[inner]\nnumber = "x"',
            "f.toml:3: inner.number: expected «int», got «str»; correct it",
        ),
        (
            'name = "a"\n[inner]\n\nnumbr = 1',
            "f.toml:4: inner.numbr is not a known key; did you mean «number»?",
        ),
        (
            'name = "a"\n[table.x]\n[table.y]\nwrd = 1',
            "f.toml:4: table.y.wrd is not a known key; did you mean «word»?",
        ),
        (
            'name = "a"\n[[row]]\n[[row]]\nwrd = 1',
            "f.toml:4: row[1].wrd is not a known key; did you mean «word»?",
        ),
        ('name = "a"\ninner = 3', "f.toml:2: inner must be a table"),
        ('name = "a"\ntable.x = 3', "f.toml:2: table.x must be a table"),
        ('name = "forbidden"', "f.toml: that name is taken; choose another"),
    ],
)
def test_problem_is_one_line_with_file_line_and_key(text: str, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    assert str(caught.value) == expected


def test_text_that_is_no_toml_names_the_line() -> None:
    with pytest.raises(ConfigError, match=r"f\.toml: not valid TOML: .*line 2"):
        parse('name = "a"\nnonsense\nmore = 1')


def test_kalibrs_target_file_is_named_with_the_command_that_reads_it() -> None:
    with pytest.raises(ConfigError, match=r"f\.toml: this is Kalibr's .*trigpoint target import"):
        parse("target_type: 'aprilgrid' # gridtype\ntagCols: 6\n")


def test_wrong_choice_names_the_choices_and_the_nearest() -> None:
    text = (
        'name = "t"\n[[faces]]\nid = 0\npattern = "chaurco"\ncolumns = 5\nrows = 7\nsquare = 0.04\n'
        "translation = [0, 0, 0]\nquaternion = [0, 0, 0, 1]\n"
    )
    with pytest.raises(TargetError) as caught:
        parse_target(text, file="t.toml")
    assert str(caught.value) == (
        "t.toml:4: faces[0].pattern: «chaurco» is none of checkerboard, charuco, aprilgrid; "
        "did you mean «charuco»?"
    )


def test_settings_stand_in_place_of_the_files_keys() -> None:
    text = 'name = "a"\ninner.number = 2'
    settings = {"inner.number": 3, "table.x.word": "w"}
    found = parse_toml(text, Outer, "f.toml", ConfigError, settings)
    assert found == Outer("a", Inner(3), {"x": Inner(word="w")})
    with pytest.raises(ConfigError, match=r"inner.numbr is not a known key; did you mean «number»"):
        parse_toml(text, Outer, "f.toml", ConfigError, {"inner.numbr": 1})
    with pytest.raises(ConfigError, match=r"«name.x»: «name» is no table"):
        parse_toml(text, Outer, "f.toml", ConfigError, {"name.x": 1})
