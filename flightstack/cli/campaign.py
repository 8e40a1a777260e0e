"""Command ``campaign``: many seeds of a scenario."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click
from rich.table import Column, Table

from flightstack.common.options import Option, takes
from flightstack.common.terminal import Bar, Terminal
from flightstack.config import options as shared
from flightstack.core.parameters.filters import short_name

if TYPE_CHECKING:
    from sim.campaign.run import Flown, Plan

COMPLETE, INCOMPLETE, WRONG_INPUT = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(shared.Result):
    """Options of ``campaign``."""

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
    folder = options.out or new_folder(f"campaign-{scenario.name}-{short_name(wanted.filter_name)}")
    console = Terminal(stderr=options.as_json)
    if line := not_proven(scenario):
        console.print(line, soft_wrap=True, markup=False)
    with Bar(console, f"{scenario.name}, filter {wanted.filter_name}", wanted.runs) as bar:
        flown = core.fly(
            wanted, folder, workers=options.workers or os.cpu_count() or 1, cluster=options.cluster,
            on_row=lambda row: bar.done(*kinds(row)),
        )  # fmt: skip
    sys.exit(_print(console, wanted, folder, flown, as_json=options.as_json, with_report=options.with_report))


def _print(
    console: Terminal, wanted: Plan, folder: Path, flown: Flown, *, as_json: bool, with_report: bool
) -> int:
    """Write the report page, and print the table or JSON; return the exit status."""
    from sim.campaign.rows import failed_rows
    from sim.campaign.run import PAGE, ROWS
    from sim.campaign.summary import apart

    if flown.missing:
        click.echo(
            f"flightstack: {flown.missing} of {wanted.runs} landings are missing; the same command with "
            f"--out {folder} flies them",
            err=True,
        )
    if flown.summary is None:
        return INCOMPLETE
    if with_report:
        from logs.report.page import ReportError

        try:
            from sim.campaign.run import write_page

            write_page(folder / PAGE, wanted, flown)
        except ReportError as error:  # the printed results are valid without a page
            click.echo(f"flightstack: {error}", err=True)
            with_report = False
    if as_json:
        click.echo(json.dumps(flown.summary))
    else:
        console.print(_table(wanted, flown.summary))
        for line in apart(flown.summary):
            console.print(line, soft_wrap=True, markup=False)
        for one in flown.summary["worst"]:
            console.print(f"{one['why']}\n  {one['command']}", soft_wrap=True)
        console.print(f"rows    {folder / ROWS}", soft_wrap=True)
        if with_report:
            console.print(f"report  {folder / PAGE}", soft_wrap=True)
    if problem := failed_rows(flown.rows):
        click.echo(f"flightstack: {problem}", err=True)
        return WRONG_INPUT
    return INCOMPLETE if flown.missing else COMPLETE


def _table(wanted: Plan, found: dict[str, Any]) -> Table:
    from sim.campaign.summary import lines

    title = f"{wanted.scenario.name}, filter {wanted.filter_name}"
    table = Table("result", Column("value", justify="right"), "unit", title=title, title_justify="left")
    for name, value, unit in lines(found):
        table.add_row(name, value, unit)
    return table
