"""The verb ``config``: the configurations that come with the package."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
def key(file: Path) -> None:
    """Write a new MAVLink signing key to FILE, readable by its owner only (docs/how_to/security.md)."""
    from bridge.mavlink.signing.key import make_key

    make_key(file)
    click.echo(f"{file}: a new signing key; give it to both ends as --signing-key, over a channel you trust")


@click.command()
@click.argument("name", required=False)
def config(name: str | None) -> None:
    """List the configurations of the onboard process that come with the package, or print the one NAMEd."""
    from flightstack.config import files as known

    if name is not None:
        click.echo(known.path_of(name).read_text(), nl=False)
        return
    for each in known.names():
        click.echo(f"{each:18} {_first_line(known.path_of(each).read_text())}")


def _first_line(text: str) -> str:
    """Return the first comment of a configuration, which says what it is for."""
    return text.partition("\n")[0].removeprefix("#").strip()
