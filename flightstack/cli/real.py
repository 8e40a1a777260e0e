"""Commands for real vehicles: ``preflight`` checks parameters, ``bridge ...`` connects other systems."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from bridge.crazyflie.rules import CrazyflieOptions
from bridge.mavlink.endpoint import open_endpoint
from bridge.mavlink.preflight.examine import Examination, Report, provision
from bridge.mavlink.profiles import profile
from bridge.mavlink.signing import load_key
from bridge.mocap.checks import MocapOptions
from flightstack.common.hangup import say
from flightstack.common.options import Option, takes
from flightstack.common.text import plain
from flightstack.config import load
from flightstack.config import options as shared
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.onboard import preflight as checks

if TYPE_CHECKING:
    from flightstack.core.types import Vec3

_COMPONENT_ID = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
_PAPER = FlightConfig(barrier=Barrier(alpha_1_m=1.0, beta_m=1.5))  # configuration if none is given


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

    The command changes nothing on the vehicle except its signing key, and that only with one of the two
    options for the key. Exit status: 0 the vehicle is safe to arm, 1 it is not safe to arm, 2 wrong input.
    """
    config = load(options.config_file) if options.config_file is not None else _PAPER
    if options.provision_signing or options.remove_signing:
        _set_up_signing(options)
    endpoint = open_endpoint("preflight", options.vehicle_url, options.system_id, _COMPONENT_ID, options)
    try:
        vehicle = Examination(
            endpoint, options.system_id, profile(options.autopilot),
            say=lambda text: print(f"preflight: {text}", file=sys.stderr),
        )  # fmt: skip
        report = checks.check(vehicle, config, wait_s=options.wait_s, accept_release=options.accept_release)
        for notice in endpoint.take_notices():
            print(f"preflight: WARNING: {notice}", file=sys.stderr)
    finally:
        endpoint.close()
    if options.as_json:
        click.echo(json.dumps(to_json(report)))
    else:
        for line in (*checks.lines(report, every=True), checks.verdict(report) or "may arm"):
            click.echo(plain(line))
    sys.exit(0 if report.safe else 1)


def _set_up_signing(options: PreflightOptions) -> None:
    """Set the vehicle's signing key, or remove it. Exit after a removal and after a failure."""
    remove, file = options.remove_signing, options.signing_key
    if file is None or options.provision_signing == remove:
        raise click.UsageError(
            "--provision-signing or --remove-signing, one of them, needs --signing-key FILE"
        )
    problem = provision(
        options.vehicle_url, options.system_id, load_key(file), remove=remove, wait_s=options.wait_s
    )
    done = "no longer signs" if remove else f"signs, with the key of {file}"
    print(f"preflight: signing: {problem or f'the vehicle {done}'}", file=sys.stderr)
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


@click.group()
def bridge() -> None:
    """Connect a stock Crazyflie as a MAVLink vehicle, or send motion-capture poses to a vehicle."""


@bridge.command()
@takes(CrazyflieOptions)
def crazyflie(options: CrazyflieOptions) -> None:
    """Run a stock Crazyflie as a MAVLink vehicle with PX4's modes (docs/how_to/crazyflie.md).

    Ctrl-C, or closing the terminal, lands a flying Crazyflie before the bridge ends. A second Ctrl-C ends the
    bridge immediately, which stops the motors.
    """
    from bridge.crazyflie import process

    sys.exit(process.run(options, _drag_1_s(options.airframe), say))


def _drag_1_s(airframe: str) -> Vec3 | None:
    """Return the ratio of rotor drag to mass along the body axes, 1/s.

    Raises ConfigError: there is no such vehicle file, or one of its keys is wrong.
    """
    if airframe == "none":
        return None
    from sim.plant.params import load

    body = load(airframe).body
    x, y, z = body.drag_n_s_m
    return (x / body.mass_kg, y / body.mass_kg, z / body.mass_kg)


@bridge.command()
@takes(MocapOptions)
def mocap(options: MocapOptions) -> None:
    """Check motion-capture poses and send them to a PX4 or ArduPilot vehicle (docs/how_to/mocap.md)."""
    from bridge.mocap import process

    sys.exit(process.run(options, say))
