"""The verb ``rare``: estimates the rate of a failure that is too rare to be counted."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import click
from rich.table import Column, Table

from flightstack.cli.options import takes
from flightstack.cli.prove.progress import Bar
from flightstack.common.options import Argument, Option
from flightstack.common.terminal import Terminal
from flightstack.config import options as shared
from flightstack.core.parameters.filters import short_name

_EVENTS = ("violation", "miss")
INCOMPLETE = 1


@dataclass(frozen=True, kw_only=True)
class RareOptions:
    """Options of ``rare``."""

    scenario: Annotated[str, Argument(metavar="SCENARIO")]
    event: Annotated[str, Option(
        "--of", "The failure: a violation of the barrier, or a crash or touch beyond the pad.",
        choices=_EVENTS
    )] = _EVENTS[0]  # fmt: skip
    landings: Annotated[int, Option(
        "--landings", "Landings of a level, a multiple of 10; a level is a factor of 10 in the rate.",
        span=(100, 1_000_000)
    )] = 500  # fmt: skip
    seed: Annotated[
        int, Option("--seed", "Of the estimate; each makes an independent one.", span=(0, 2**62))
    ] = 0
    filter: Annotated[str | None, shared.safety_filter("Safety filter; default: the scenario's")] = None
    workers: shared.Workers = None
    out: Annotated[Path | None, Option(
        "--out", "Folder; an estimate that it holds in part is continued. Default: a new folder in runs/.",
        path="folder"
    )] = None  # fmt: skip
    as_json: shared.AsJson = False


@click.command()
@takes(RareOptions)
def rare(options: RareOptions) -> None:
    """Estimate the rate of a rare failure of a SCENARIO by subset simulation, and give seeds that show it.

    The first level's landings are free, each next level's are drawn among those ten times as near to the
    failure. Ctrl-C keeps what was flown; the same call with the same --out goes on.

    Exit status: 0 complete, 1 interrupted or a landing could not be flown, 2 wrong input.
    """
    from flightstack.onboard.recording import new_folder
    from sim.campaign import rare as core
    from sim.campaign.run import plan

    wanted = core.Rare(
        plan(options.scenario, options.landings, options.seed, options.filter), core.Event(options.event)
    )
    scenario = wanted.plan.scenario
    folder = options.out or new_folder(f"rare-{scenario.name}-{short_name(wanted.plan.filter_name)}")
    console = Terminal(stderr=options.as_json)
    title = f"{scenario.name}, filter {wanted.plan.filter_name}, {options.event}"
    try:
        with Bar(console, title, None) as bar:
            told = core.fly(
                wanted, folder, workers=options.workers or os.cpu_count() or 1,
                on_row=bar.row,
            )  # fmt: skip
    except KeyboardInterrupt:
        click.echo(f"flightstack: interrupted; the same command with --out {folder} goes on", err=True)
        sys.exit(INCOMPLETE)
    if options.as_json:
        click.echo(json.dumps(told))
        return
    console.print(_levels(title, told))
    low, high = told["interval_95"]
    rate = f"rate {told['rate']:.2g}" if told["rate"] else "no failure found: rate"
    console.print(f"{rate}, 95 % interval {low:.2g} to {high:.2g}, {told['landings']} landings")
    for one in told["failures"]:
        console.print(f"{one['why']}\n  {one['command']}", soft_wrap=True)
    console.print(f"rows    {folder / 'rows.csv'}", soft_wrap=True)


def _levels(title: str, told: dict[str, Any]) -> Table:
    columns = [Column(name, justify="right") for name in ("from, mm", "to, mm", "share", "moves accepted")]
    table = Table("level", *columns, title=title, title_justify="left")
    for number, level in enumerate(told["levels"]):
        begins, ends = (f"{1e3 * level[key]:.1f}" for key in ("begins_at", "ends_at"))
        accepted = f"{100.0 * level['accepted']:.0f} %" if number else "-"
        table.add_row(str(number), begins, ends, f"{100.0 * level['share']:.1f} %", accepted)
    return table
