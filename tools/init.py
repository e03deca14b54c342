"""`trigpoint init`: a first site.toml and target.toml."""

from pathlib import Path
from typing import Annotated

import typer

from trigpoint.errors import InputError, OperationError

from .site_file import first_site_text, first_target_text, full_site_text


def main(
    full: Annotated[bool, typer.Option("--full", help="Every key, with its default.")] = False,
    directory: Annotated[Path, typer.Option(help="Where to write them.")] = Path(),
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> None:
    """Write a first site.toml and target.toml that work, to be filled in."""
    texts = {
        directory / "site.toml": full_site_text() if full else first_site_text(),
        directory / "target.toml": first_target_text(),
    }
    for path in texts:
        if path.exists() and not force:
            raise InputError(f"{path} exists already; add --force to replace it")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
    except OSError as reason:
        raise OperationError(
            f"{directory}: nothing can be written there ({reason.strerror}); choose another"
        ) from None
    for path in texts:
        typer.echo(f"wrote {path}")
    typer.echo(f"next: edit them, then trigpoint doctor --site {directory / 'site.toml'}")
