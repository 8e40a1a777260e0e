"""The inputs that a tick takes from its links, and the outputs it gives them, without sockets and clocks.

Live flight and replay do it here, so that a replay of the wire is a replay of what flew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from bridge.mavlink.client.link import VehicleLink
from bridge.target.odometry import OdometryError, sample_from_cdr
from flightstack.core.controller import Outputs
from flightstack.core.types import Inputs, Operator, TargetSample


class Taken(NamedTuple):
    """The arguments of ``Controller.step``, and the errors of samples that could not be decoded."""

    inputs: Inputs
    command_failed: bool
    problems: list[str]


def take(link: VehicleLink, odometry: Sequence[bytes], operator: Operator, now_s: float) -> Taken:
    """Gather the inputs of a tick.

    Args:
        link: of the vehicle, polled before.
        odometry: serialised samples of the target that came since the last tick.
        operator: what a person asks for.
        now_s: the stack's clock.
    """
    samples: list[TargetSample] = []
    problems: list[str] = []
    for payload in odometry:
        try:
            samples.append(sample_from_cdr(payload, now_s))
        except OdometryError as error:
            problems.append(f"target sample refused: {error}")
    return Taken(Inputs(link.own, link.status, tuple(samples), operator), link.failed is not None, problems)


def answer(link: VehicleLink, out: Outputs, now_s: float, *, lockstep: bool) -> bytes:
    """Send the outputs of a tick; return the frame that ends a lockstep tick, else None."""
    if out.setpoint is not None:
        link.send_setpoint(out.setpoint, now_s)
    link.command(out.request, now_s)
    if not lockstep:
        link.flush()
        return b""
    reply = link.timesync_reply(round(now_s * 1e9))
    link.flush([reply])
    return bytes(reply.get_msgbuf() or b"")
