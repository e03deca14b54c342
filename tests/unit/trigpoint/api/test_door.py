"""What `import trigpoint` offers, and what it costs."""

import ast
import inspect
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import trigpoint as tp

PACKAGE = Path(tp.__file__).parent


def modules_after(code: str) -> set[str]:
    code = f"import sys; {code}; print(*sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return set(result.stdout.split())


def test_importing_it_imports_nothing_else() -> None:
    ours = {name for name in modules_after("import trigpoint") if name.startswith("trigpoint")}
    assert ours == {"trigpoint"}
    assert {"typing", "numpy"}.isdisjoint(modules_after("import trigpoint") - modules_after("0"))


def test_a_network_needs_no_extra() -> None:
    heavy = {"cv2", "scipy", "mcap", "zenoh", "av", "serial", "rerun", "rosbags"}
    assert heavy.isdisjoint(modules_after("from trigpoint import read_network, Distances, plugins"))


def test_every_public_name_opens_and_says_what_it_is() -> None:
    for name in tp.__all__:
        found = getattr(tp, name)
        assert isinstance(found, int | str) or inspect.getdoc(found), name
    for name in tp.plugins.__all__:
        assert getattr(tp.plugins, name) is not None
    assert set(tp.__all__) <= set(dir(tp))
    with pytest.raises(AttributeError, match="has no attribute 'calibrat'"):
        getattr(tp, "calibrat")  # noqa: B009 - pyright knows that it is not there


def test_editors_see_exactly_the_public_names() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    (shown,) = [node for node in tree.body if isinstance(node, ast.If)]
    imported = [n for n in shown.body if isinstance(n, ast.ImportFrom)]
    names = {alias.name for node in imported for alias in node.names}
    assert names == {*tp.__all__} - {"CONTRACT", "__version__"}
    assert (PACKAGE / "py.typed").exists()


@pytest.mark.parametrize(
    ("package", "use", "extra"),
    [
        ("cv2", "tp.detect", "edge"),
        ("mcap", "tp.open_session", "recorder"),
        ("mcap", "tp.calibrate", "fusion,recorder"),
    ],
)
def test_what_is_not_installed_is_one_line_with_the_command(
    package: str, use: str, extra: str
) -> None:
    code = f"import sys; sys.modules['{package}'] = None; import trigpoint as tp; {use}"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    *_, last = result.stderr.splitlines()
    assert last.startswith("trigpoint.base.errors.MissingExtraError: `trigpoint.")
    assert f"needs the package «{package}»" in last
    assert f"pip install -c constraints.txt 'trigpoint[{extra}] @ " in last


def test_a_module_of_ours_that_is_missing_is_no_missing_extra() -> None:
    code = "import sys; sys.modules['trigpoint.map.network'] = None; from trigpoint import Network"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "ModuleNotFoundError" in result.stderr.splitlines()[-1]


def test_the_package_says_what_it_is() -> None:
    about = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    assert "Typing :: Typed" in about["classifiers"]
    assert about["keywords"]
    assert {"authors", "urls"}.isdisjoint(about)
