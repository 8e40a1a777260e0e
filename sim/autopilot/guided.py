"""ArduPilot's GUIDED mode, which is two of ours: its own take-off, and following set-points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim.autopilot.modes import FlightMode

if TYPE_CHECKING:
    from sim.autopilot.flight import Flight

GUIDED = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF})


def why_no_takeoff(flight: Flight, height_m: float | None, z_m: float) -> str | None:
    """Why GUIDED does not take off now, None if it does (ArduPilot mode_guided.cpp, takeoff.cpp).

    Args:
        flight: of the vehicle.
        height_m: local height asked for.
        z_m: local height of the vehicle.
    """
    if flight.mode is FlightMode.TAKEOFF and height_m == flight.pilot.takeoff_height_m and flight.standing:
        return None  # the command again
    if flight.mode not in GUIDED:
        return f"Take-off refused: mode is {flight.personality.label(flight.mode)}, GUIDED is needed"
    if not flight.vehicle.armed:
        return "Take-off refused: not armed"
    if not flight.standing:
        return "Take-off refused: in the air"
    if height_m is None or height_m <= z_m:
        return "Take-off refused: a height above the vehicle is needed"
    return None
