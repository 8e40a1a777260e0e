"""Commands for many flights: ``campaign`` flies the seeds of a scenario, ``validate`` compares flights."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click
import msgspec
from rich.box import SIMPLE
from rich.table import Column, Table
from rich.text import Text

from flightstack.common.options import Option, takes
from flightstack.common.terminal import Bar, Terminal
from flightstack.config import options as shared
from sim.options import ValidateOptions

if TYPE_CHECKING:
    from sim.campaign.run import Flown, Plan

COMPLETE, INCOMPLETE, WRONG_INPUT = 0, 1, 2
PASSED, FAILED = 0, 1


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(shared.Result):
    scenario: Annotated[str, Option("SCENARIO")]
    runs: Annotated[int, Option("--runs", "Landings.", span=(1, 10_000_000))] = 1000
    first_seed: Annotated[int, Option("--seed", "First seed.", span=(0, 2**62))] = 0
    filter: Annotated[str | None, shared.safety_filter("Safety filter; default: the scenario's")] = None
    workers: shared.Workers = None
    cluster: Annotated[
        str | None, Option("--cluster", "Fly on a Dask cluster, e.g. tcp://10.0.0.2:8786.", metavar="ADDRESS")
    ] = None
    out: Annotated[Path | None, Option(
        "--out",
        "Folder; a campaign that it already holds in part is continued. Default: a new folder in runs/.",
        path="folder"
    )] = None  # fmt: skip


@click.command()
@takes(CampaignOptions)
def campaign(options: CampaignOptions) -> None:
    """Fly a SCENARIO with many seeds in fast simulation, each as `sitl --lockstep` would fly it, and sum up.

    Ctrl-C keeps the finished landings; the same call with the same --out continues.

    Exit status: 0 complete, whatever the result, 1 landings are missing, 2 wrong input, or your own code
    failed in a landing.
    """
    from flightstack.onboard.recording import new_folder
    from sim.campaign import run as core
    from sim.campaign.summary import kinds
    from sim.vehicle.declared import not_proven

    wanted = core.plan(options.scenario, options.runs, options.first_seed, options.filter)
    scenario = wanted.scenario
    name = wanted.filter_name.rpartition(":")[2]
    folder = options.out or new_folder(f"campaign-{scenario.name}-{name}")
    console = Terminal(stderr=options.as_json)
    if line := not_proven(scenario):
        console.print(line, soft_wrap=True, markup=False)
    with Bar(console, f"{scenario.name}, filter {wanted.filter_name}", wanted.runs) as bar:
        flown = core.fly(
            wanted, folder, workers=options.workers or os.cpu_count() or 1, cluster=options.cluster,
            on_row=lambda row: bar.done(*kinds(row)),
        )  # fmt: skip
    sys.exit(_print(console, wanted, folder, flown, options))


def _print(console: Terminal, wanted: Plan, folder: Path, flown: Flown, options: CampaignOptions) -> int:
    """Write the report page, and print the table or JSON; return the exit status."""
    from flightstack.common.text import MissingExtraError
    from logs.report.page import ReportError
    from sim.campaign.rows import failed_rows
    from sim.campaign.run import PAGE, ROWS, write_page
    from sim.campaign.summary import apart, lines

    if flown.missing:
        click.echo(
            f"flightstack: {flown.missing} of {wanted.runs} landings are missing; the same command with "
            f"--out {folder} flies them",
            err=True,
        )
    if flown.summary is None:
        return INCOMPLETE
    page = folder / PAGE if options.with_report else None
    try:
        if page is not None:
            write_page(page, wanted, flown)
    except (ReportError, MissingExtraError) as error:  # the results are valid without a page
        click.echo(f"flightstack: {error}", err=True)
        page = None
    if options.as_json:
        click.echo(json.dumps(flown.summary))
    else:
        title = f"{wanted.scenario.name}, filter {wanted.filter_name}"
        table = Table("result", Column("value", justify="right"), "unit", title=title, title_justify="left")
        for row in lines(flown.summary):
            table.add_row(*row)
        console.print(table)
        for line in apart(flown.summary):
            console.print(line, soft_wrap=True, markup=False)
        for one in flown.summary["worst"]:
            console.print(f"{one['why']}\n  {one['command']}", soft_wrap=True)
        console.print(f"rows    {folder / ROWS}", soft_wrap=True)
        if page is not None:
            console.print(f"report  {page}", soft_wrap=True)
    if problem := failed_rows(flown.rows):
        click.echo(f"flightstack: {problem}", err=True)
        return WRONG_INPUT
    return INCOMPLETE if flown.missing else COMPLETE


@click.command()
@takes(ValidateOptions)
def validate(options: ValidateOptions) -> None:
    """Compare the simulator with recorded flights in DIR (Parquet, CSV): plant, closed loop, state estimate.

    Unusable flights and unusable parts of flights are listed with the reason (docs/how_to/validate.md).

    Exit status: 0 all criteria are met, 1 a criterion is missed or no flight is usable, 2 wrong input.
    """
    from flightstack.onboard.recording import new_folder
    from sim.flights.recording import SUFFIXES
    from sim.validation import run as core
    from sim.validation.criteria import judge, reasons, summary

    console = Terminal(stderr=options.as_json)
    paths = sorted(path for path in options.folder.iterdir() if path.suffix in SUFFIXES)
    if not paths:
        text = f"{options.folder}: found no flights; files with {' or '.join(SUFFIXES)} are read"
        console.print(text, soft_wrap=True)
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
    written = msgspec.json.encode(found, enc_hook=float)  # ``enc_hook`` converts numpy's numbers
    (folder / "validate.json").write_bytes(msgspec.json.format(written, indent=1) + b"\n")
    if options.as_json:
        click.echo(written)
    else:
        _print_criteria(console, found)
    sys.exit(PASSED if found["passed"] else FAILED)


def _print_criteria(console: Terminal, found: dict[str, Any]) -> None:
    """Print the table of criteria and the causes."""
    used = f"{found['used']} of {found['flights']} flights, {found['used_s']:.0f} s"
    title = f"{used}, beside {found['vehicle']}"
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
