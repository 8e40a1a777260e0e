"""Commands ``bridge ...``: each connects the stack to another system in its own process."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from bridge.crazyflie.rules import CrazyflieOptions
from bridge.mocap.checks import MocapOptions
from flightstack.common.hangup import say
from flightstack.common.options import takes

if TYPE_CHECKING:
    from flightstack.core.types import Vec3


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

    drag_1_s = _drag_1_s(options.airframe)
    if options.mocap_key is None:
        sys.exit(process.run(options, drag_1_s, say=say))

    from bridge.mocap.checks import PoseChecks
    from bridge.mocap.process import MocapSource, limits, parse_spec, summary
    from bridge.zenoh import zenoh_link

    process.check_uri(options.uri)
    spec = parse_spec(options.mocap_key, options.pose_type, options.ros_domain)
    session = zenoh_link.open_session(
        options.listen, options.connect, config_file=options.zenoh_config, prompt=True
    )
    try:
        poses = MocapSource(session, spec, PoseChecks(limits(options)), options.offset_flu_m)
        status = process.run(options, drag_1_s, poses, say)
        say(summary(poses.checks))
    finally:
        session.close()
    sys.exit(status)


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
