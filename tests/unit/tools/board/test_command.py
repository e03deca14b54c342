"""The command's own words: what is wrong with what it was given, and that it ends."""

import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from support.builders import TARGET_TEXT, site_text
from support.commands import Cli

from trigpoint.base.errors import ConfigError
from trigpoint.cli import run
from trigpoint.site.config import load_site
from trigpoint.tools.board.app import assets
from trigpoint.tools.board.operator import check_operator


def site_file(folder: Path, **settings: str) -> Path:
    (folder / "target.toml").write_text(TARGET_TEXT, encoding="utf-8")
    path = folder / "site.toml"
    path.write_text(site_text(**settings), encoding="utf-8")  # pyright: ignore
    return path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--host", "0.0.0.0"], "--certificate FILE.pem, --key FILE.key and --token FILE"),
        (["--token", "none"], "there is no such token file"),
        (["--operator"], "this site has no certificates"),
        (["--port", "70000"], "70000"),
    ],
)
def test_bad_use_is_one_line_and_status_2(
    words: list[str], said: str, tmp_path: Path, cli: Cli
) -> None:
    error = cli.refused("board", "--site", site_file(tmp_path), *words)
    assert said in error
    assert error.count("\n") == 1


def test_a_plan_that_is_not_there_is_said(tmp_path: Path, cli: Cli) -> None:
    site = site_file(tmp_path, more='[map]\nplan = "hall.yaml"')
    assert "hall.yaml" in cli.refused("board", "--site", site)


def test_only_an_operators_certificate_opens_commands(tmp_path: Path) -> None:
    text = '[bus.tls]\ndirectory = "secure"'
    site = load_site(site_file(tmp_path, more=text))
    folder = tmp_path / "secure"
    folder.mkdir()
    with pytest.raises(ConfigError, match="no key of an operator or a viewer"):
        check_operator(site)
    site_words = ["--site", str(tmp_path / "site.toml"), "--authority", str(tmp_path / "authority")]
    assert run(["secure", "init", *site_words]) == 0
    assert run(["secure", "node", "viewer", "bob", *site_words]) == 0
    with pytest.raises(ConfigError, match="is of the viewer «bob»"):
        check_operator(site)
    assert run(["secure", "node", "operator", "anna", *site_words]) == 0
    check_operator(site)


def test_the_files_of_the_page_are_in_the_package_and_ask_nothing_of_others() -> None:
    for name, data in assets().items():
        text = data.decode()
        assert not re.search(r"https?://(?!www\.w3\.org/)", text), name
        assert not re.search(r"<script(?![^>]*src=\"/)|<[^>]* (style|on\w+)=|javascript:", text), (
            name
        )
    assert {"board.html", "login.html", "board.js", "mark.svg"} <= assets().keys()


def test_it_says_where_it_is_and_ends_when_told(tmp_path: Path) -> None:
    site = site_file(tmp_path)
    words = ["board", "--site", str(site), "--port", "0"]
    board = subprocess.Popen(
        [sys.executable, "-m", "trigpoint", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert board.stdout is not None
        address = board.stdout.readline().rpartition(" ")[2].strip()
        with urllib.request.urlopen(address, timeout=20) as answer:
            assert b"board.js" in answer.read()
        begin = time.monotonic()
        board.send_signal(signal.SIGTERM)
        assert board.wait(20) == 0
        assert time.monotonic() - begin < 2.5
    finally:
        board.kill()
        board.communicate()
