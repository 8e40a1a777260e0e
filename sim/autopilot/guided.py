"""ArduPilot's GUIDED mode, which is two of ours: its own take-off, and following set-points."""

from __future__ import annotations

from typing import NamedTuple

from bridge.mavlink.server.profile import FlightMode

GUIDED = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF})


class Situation(NamedTuple):
    """What the answer to a take-off command depends on.

    Attributes:
        mode: of the vehicle.
        label: ArduPilot's name of that mode.
        armed: whether it is.
        standing: on the ground.
        takeoff_height_m: local height that a take-off under way aims at.
        z_m: local height of the vehicle.
    """

    mode: FlightMode
    label: str
    armed: bool
    standing: bool
    takeoff_height_m: float | None
    z_m: float


def why_no_takeoff(now: Situation, height_m: float | None) -> str | None:
    """Why GUIDED does not take off now, None if it does (ArduPilot mode_guided.cpp, takeoff.cpp).

    Args:
        now: the vehicle.
        height_m: local height asked for.
    """
    if now.mode is FlightMode.TAKEOFF and height_m == now.takeoff_height_m and now.standing:
        return None  # the command again
    if now.mode not in GUIDED:
        return f"Take-off refused: mode is {now.label}, GUIDED is needed"
    if not now.armed:
        return "Take-off refused: not armed"
    if not now.standing:
        return "Take-off refused: in the air"
    if height_m is None or height_m <= now.z_m:
        return "Take-off refused: a height above the vehicle is needed"
    return None
