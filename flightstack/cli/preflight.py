"""Command ``preflight``: checks the vehicle's parameters for a flight, and never changes one."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import click
from rich.table import Column, Table
from rich.text import Text

from bridge.mavlink.endpoint import open_endpoint
from bridge.mavlink.preflight.examine import Report, provision
from bridge.mavlink.preflight.table import Level
from bridge.mavlink.signing import load_key
from flightstack.common.options import Option, takes
from flightstack.common.terminal import Terminal
from flightstack.config import load
from flightstack.config import options as shared
from flightstack.core.parameters.flight import BarrierShape, FlightConfig
from flightstack.onboard import preflight as checks

_STYLE = {
    Level.OK: "green", Level.INFO: "cyan", Level.NOTE: "yellow", Level.UNSAFE: "bold red",
    Level.ACCEPTED: "magenta",
}  # fmt: skip
_COMPONENT_ID = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
_PAPER = FlightConfig(barrier=BarrierShape(alpha_1_m=1.0, beta_m=1.5))  # configuration if none is given


@dataclass(frozen=True, kw_only=True)
class PreflightOptions(shared.Signing, shared.Piloted, shared.Vehicle):
    """Options of ``preflight``."""

    config_file: Annotated[Path | None, shared.config(
        "Configuration of the flight; default: the paper's limits, no parameter accepted"
    )] = None  # fmt: skip
    wait_s: Annotated[
        float, Option("--wait", "Longest wait for the vehicle's heartbeat.", metavar="S", span=(0.1, 600.0))
    ] = 10.0
    provision_signing: Annotated[bool, Option(
        "--provision-signing", "First send the key of --signing-key to the vehicle, over a cable or loopback."
    )] = False  # fmt: skip
    remove_signing: Annotated[bool, Option(
        "--remove-signing",
        "Remove the key of --signing-key from the vehicle and exit, over a cable or loopback."
    )] = False  # fmt: skip
    as_json: shared.AsJson = False


@click.command()
@takes(PreflightOptions)
def preflight(options: PreflightOptions) -> None:
    """Read the vehicle's safety parameters and print what is unsafe, why, and what to set.

    Nothing is changed on the vehicle except its signing key, if one of the two options requests that. Exit
    status: 0 it may arm, 1 it must not arm, 2 wrong input.
    """
    config = load(options.config_file) if options.config_file is not None else _PAPER
    if options.provision_signing or options.remove_signing:
        _set_up_signing(options)
    endpoint = open_endpoint("preflight", options.vehicle_url, options.system_id, _COMPONENT_ID, options)
    try:
        report = checks.check(
            endpoint, config, options.autopilot, options.system_id, wait_s=options.wait_s,
            accept_release=options.accept_release,
            say=lambda text: print(f"preflight: {text}", file=sys.stderr),
        )  # fmt: skip
        for notice in endpoint.take_notices():
            print(f"preflight: WARNING: {notice}", file=sys.stderr)
    finally:
        endpoint.close()
    if options.as_json:
        click.echo(json.dumps(to_json(report)))
    else:
        _print(report)
    sys.exit(0 if report.safe else 1)


def _set_up_signing(options: PreflightOptions) -> None:
    """Set the vehicle's signing key, or remove it and exit.

    Raises click.UsageError: no key is given, or both options are given.
    """
    remove = options.remove_signing
    if options.signing_key is None or options.provision_signing == remove:
        raise click.UsageError(
            "--provision-signing or --remove-signing, one of them, needs --signing-key FILE"
        )
    key = load_key(options.signing_key)
    problem = provision(options.vehicle_url, options.system_id, key, remove=remove, wait_s=options.wait_s)
    if problem is not None:
        print(f"preflight: signing: {problem}", file=sys.stderr)
    elif remove:
        print("preflight: signing: the vehicle no longer signs", file=sys.stderr)
    else:
        print(
            f"preflight: signing: the vehicle signs, with the key of {options.signing_key}", file=sys.stderr
        )
    if problem is not None or remove:
        sys.exit(0 if problem is None else 1)


def to_json(report: Report) -> dict[str, Any]:
    """Return the object that ``--json`` prints."""
    return {
        "safe": report.safe,
        "autopilot": report.profile.name if report.profile is not None else None,
        "version": report.version,
        "rules": report.rules,
        "notes": list(report.notes),
        "problem": report.problem,
        "line": report.line,
        "parameters": [{**asdict(f), "level": f.level.value.lower()} for f in report.findings],
    }


def _print(report: Report) -> None:
    console = Terminal()
    if report.profile is not None:
        title = f"{report.profile.title}, release {report.version or 'unknown'}"
        columns = (Column(name, overflow="fold") for name in ("parameter", "value", "is", "wanted", "why"))
        table = Table(*columns, title=title, title_justify="left")
        for finding in report.findings:
            level = Text(finding.level.value, style=_STYLE[finding.level])
            table.add_row(finding.name, finding.shown, level, finding.wanted, finding.why)
        console.print(table)
    for note in report.notes:
        console.print(f"note: {note}", soft_wrap=True)
    if report.line is not None:
        console.print(report.line, soft_wrap=True)
    console.print(checks.verdict(report) or "may arm", soft_wrap=True)
