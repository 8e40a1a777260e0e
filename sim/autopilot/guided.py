"""ArduPilot's GUIDED mode, which is two of ours: its own take-off, and following set-points."""

from __future__ import annotations

from bridge.mavlink.server.profile import FlightMode

GUIDED = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF})


def why_no_takeoff(
    mode: FlightMode, name: str, armed: bool, standing: bool, height_m: float | None, aim_m: float, z_m: float
) -> str | None:
    """Why GUIDED does not take off now, None if it does (ArduPilot mode_guided.cpp, takeoff.cpp).

    Args:
        mode: of the vehicle.
        name: ArduPilot's name of that mode.
        armed: whether it is.
        standing: on the ground.
        height_m: local height asked for.
        aim_m: local height of a take-off under way.
        z_m: local height of the vehicle.
    """
    if mode is FlightMode.TAKEOFF and height_m == aim_m and standing:
        return None  # the command again
    if mode not in GUIDED:
        return f"Take-off refused: mode is {name}, GUIDED is needed"
    if not armed:
        return "Take-off refused: not armed"
    if not standing:
        return "Take-off refused: in the air"
    if height_m is None or height_m <= z_m:
        return "Take-off refused: a height above the vehicle is needed"
    return None
