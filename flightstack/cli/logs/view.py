"""The verb ``view``: a flight in Rerun, and layouts for other viewers."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import click

from flightstack.cli.options import without_rerun
from flightstack.common.text import plain

SHOWN, BROKEN = 0, 1


@click.command()
@click.argument("log_file", metavar="LOG", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--save", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE.rrd",
    help="Write a Rerun recording instead of opening a window.",
)  # fmt: skip
@click.option(
    "--web", is_flag=True, help="Serve Rerun to a browser of this machine, instead of opening a window."
)
@click.option(
    "--layouts", type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
    help="Only write layouts for Foxglove and PlotJuggler there, with the topics of this LOG.",
)  # fmt: skip
@click.option("--member", metavar="NAME", help="Show the flight of this member of a fleet alone, e.g. cf2.")
@click.option("--force", is_flag=True, help="Replace files that exist.")
def view(
    log_file: Path, save: Path | None, web: bool, layouts: Path | None, member: str | None, force: bool
) -> None:
    """Show a LOG in Rerun: the scene in 3-D, curves and events (docs/how_to/viewing.md).

    Of a fleet: all members in one scene.

    Needs the extra `view`, except for --layouts. Exit status: 0 shown or written, 1 the same of a broken LOG,
    2 wrong input or no window.
    """
    if layouts is not None:
        from logs.view.layout_files import write_layouts

        for path in write_layouts(log_file, layouts, member, force=force):
            click.echo(plain(path))
        return
    try:
        from logs.view.view import Recording, open_viewer
    except ModuleNotFoundError as error:
        raise without_rerun(error, "view") from error
    recording = Recording(log_file, member)
    if save is not None:
        from logs.tools.file import new_file

        with new_file(save, force=force) as part:
            recording.save(part)
        click.echo(plain(f"{save}: open it with `rerun {save}`"))
    _warn(recording.problem)
    if save is None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{log_file.stem}.rrd"
            recording.save(file)
            if open_viewer(file, web=web):
                raise ValueError(
                    "Rerun did not open; without a display use --web, or --save and another machine"
                )
    sys.exit(BROKEN if recording.problem else SHOWN)


def _warn(problem: str) -> None:
    if problem:
        click.echo(plain(f"flightstack: the log is broken; what can be read is shown: {problem}"), err=True)
