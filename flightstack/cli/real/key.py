"""The verb ``key``: makes a MAVLink signing key."""

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
