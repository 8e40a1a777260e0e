"""Command ``validate``: comparison of the simulator with recorded flights of a real vehicle."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from flightstack.common.options import takes
from flightstack.common.terminal import Bar, Terminal
from flightstack.common.text import pip_install, without
from sim.options import ValidateOptions

PASSED, FAILED = 0, 1
PAGE, SUMMARY = "validate.html", "validate.json"


@click.command()
@takes(ValidateOptions)
def validate(options: ValidateOptions) -> None:
    """Compare the simulator with recorded flights in DIR (Parquet, CSV): plant, closed loop, state estimate.

    Flights that cannot be used, or only in part, are listed with the reason (docs/how_to/validate.md).

    Exit status: 0 all criteria are met, 1 a criterion is missed or no flight is usable, 2 wrong input.
    """
    from flightstack.onboard.recording import new_folder

    try:
        from sim.flights.recording import RecordingError, find_recordings
        from sim.validation import run as core
        from sim.validation.criteria import judge, reasons, summary
    except ModuleNotFoundError as error:
        text = f"`validate` needs {{}}: {pip_install('sim,export')}"
        raise without(error, text, "pyarrow", "mujoco", "numba") from None

    options = replace(options, vehicle=options.vehicle or core.VEHICLE)
    console = Terminal(stderr=options.as_json)
    try:
        paths = find_recordings(options.folder)
    except RecordingError as error:
        console.print(str(error), soft_wrap=True)
        paths = []
    with Bar(console, f"flights of {options.folder}", len(paths)) as bar:
        flights = core.run(
            options, paths, options.workers or os.cpu_count() or 1,
            on_flight=lambda one: bar.done("used" if one.used else "left out"),
        )  # fmt: skip
    found = summary(options, flights, judge(flights))
    for flight in flights:
        if flight.left_out:
            what = "left out in part" if flight.used else "left out"
            console.print(f"{flight.name}: {what}: {'; '.join(reasons(flight))}", soft_wrap=True)
    folder = options.out or new_folder("validate")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SUMMARY).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    page = _page(folder / PAGE, found) if options.with_report else None
    if options.as_json:
        click.echo(json.dumps(found))
    else:
        _print(console, found)
        if page is not None:
            console.print(f"report  {page}", soft_wrap=True)
    sys.exit(PASSED if found["passed"] else FAILED)


def _page(path: Path, found: dict[str, Any]) -> Path | None:
    """Write the page and return its path; None if writing fails, since the printed numbers are sufficient."""
    from logs.report.page import ReportError, write
    from sim.validation.page import validation_page

    try:
        write(path, validation_page(found))
    except ReportError as error:
        click.echo(f"flightstack: {error}", err=True)
        return None
    return path


def _print(console: Terminal, found: dict[str, Any]) -> None:
    """Print the table of criteria and the causes."""
    title = (
        f"{found['used']} of {found['flights']} flights, {found['used_s']:.0f} s, beside {found['vehicle']}"
    )
    table = Table(
        "error", "limit", "found (95 %)", "", box=SIMPLE, pad_edge=False, title=title, title_justify="left"
    )
    for part in dict.fromkeys(one["part"] for one in found["criteria"]):
        table.add_section()
        table.add_row(Text(part, style="bold"))
        for one in found["criteria"]:
            if one["part"] == part:
                mark = Text(one["word"], style="none" if one["met"] else "bold red")
                table.add_row(one["text"], one["limit"], one["found"], mark)
    if found["used"]:
        console.print(table)
    console.print("passed" if found["passed"] else "not passed")
    for cause in found["causes"]:
        console.print(f"  {cause}", soft_wrap=True)
