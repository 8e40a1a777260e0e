"""The verb ``key``: makes a key that signs MAVLink."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
def key(file: Path) -> None:
    """Make a MAVLink signing key in a new FILE that its owner alone can read (docs/how_to/security.md)."""
    from bridge.mavlink.signing.key import make_key

    make_key(file)
    click.echo(f"{file}: a new signing key; give it to both ends as --signing-key, over a channel you trust")
