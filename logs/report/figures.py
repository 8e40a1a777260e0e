"""All figures of the report, in order, each with its description and the source of its numbers."""

from __future__ import annotations

from collections.abc import Sequence

from logs.reader.fleet_messages import FleetMessages
from logs.reader.flight_data import Fleet, Flight
from logs.report import series, several, space
from logs.report.derived import Side
from logs.report.page import Panel
from logs.report.style import axis_of, fleet_axis
from logs.report.timeline import timeline
from logs.verdict.types import RADIUS_ABOVE_M, RADIUS_BESIDE_M
from logs.verdict.verdict import PairSeries


def panels(side: Side) -> list[Panel]:
    """Return the figures of one flight; the first is the main picture."""
    flight, axis = side.flight, axis_of(side.flight)
    both = "Solid: true states of the simulator. Dashed: the vehicle's own estimate."
    source = both if flight.truth is not None else "The vehicle's own estimate; the log holds no true states."
    edge = "" if flight.barrier is not None else " The log does not name the barrier; none is drawn."
    return [
        Panel(
            "relative", "Landing relative to the pad, over the barrier",
            f"{source} Surface: h = 0; unsafe below it.{edge}", space.trajectory_3d(flight), "Fig. 7, 10",
        ),
        Panel(
            "timeline", "The flight at a glance", _TIMELINE,
            timeline([side], axis, flight.events, -side.offset_s),
        ),
        Panel(
            "altitude", "Relative altitude over horizontal distance",
            f"{source} Shaded: unsafe, h < 0.{edge}",
            space.altitude_over_distance(side), "Fig. 8, 11",
        ),
        Panel(
            "barrier", "Barrier value over time",
            f"{_barrier_source(flight)} Dotted: −5 mm, the limit of a violation outside the pad. {_MARGIN}",
            series.barrier_over_time(flight, side.verdict), "Fig. 9a, 13a",
        ),
        Panel(
            "velocity", "Velocity: nominal, filtered, sent",
            _VELOCITY + (_SWITCH if flight.truth is not None else ""),
            series.velocities(flight), "Fig. 9b–d, 13b–d",
        ),
        Panel("filter", "What the filter does", _FILTER, series.filter_activity(flight)),
        Panel("tracking", "Velocity: wanted, set-point, flown", _TRACKING, series.tracking(flight)),
        Panel("error", "Error of the estimates", _ERROR, series.estimate_error(flight)),
        Panel("plan", "Paths from above", f"{source} {_PLAN}", space.plan([side]), "Fig. 12"),
        Panel("vehicle", "The vehicle", _VEHICLE, series.vehicle_state(flight)),
        Panel("timing", "Loop timing", _TIMING, series.loop_timing(flight)),
        Panel("age", "Age of the data at each tick", "As the controller saw it.", series.data_age(flight)),
    ]  # fmt: skip


def fleet_panels(
    fleet: Fleet, sides: Sequence[Side], messages: FleetMessages, pairs: Sequence[PairSeries]
) -> list[Panel]:
    """Return the figures of a fleet; the first is the main picture."""
    axis = fleet_axis(fleet)
    return [
        Panel("room", "All paths in the room", _ROOM, space.room_3d(sides)),
        Panel(
            "timeline", "Who did what, and who waited for whom", _LANES,
            timeline(sides, axis, fleet.events, messages=messages),
        ),
        Panel("plan", "Paths from above", _ROOM, space.plan(sides)),
        Panel("pairs", "Distance of each pair", _NEAR, several.distances(pairs, axis)),
        Panel("barriers", "Barrier value of each member", _BARRIERS, several.barriers(sides, axis)),
    ]  # fmt: skip


_LANES = (
    "Two lanes for each member: its phase, and the intent that it sent to the others. Orange: it flew and "
    "gave way to a neighbour. Red, if any: a member received no message from a neighbour for longer than "
    "allowed. Touch or point at a bar to read it."
)
_ROOM = (
    "True paths, or the vehicles' own estimates where the log has no true states. Dotted: the pads. Circle: "
    "start. Square: end. From above, triangle: first contact; ring: the pad at the end."
)
_NEAR = (
    f"By true states. The ellipsoid of two vehicles has the semi-axes {2 * RADIUS_BESIDE_M:g} m sideways and "
    f"{2 * RADIUS_ABOVE_M:g} m up and down; its measure is 1 on the surface, below is too near. It counts "
    "while both fly; thin: one of them rests. Dotted, in metres, of up to three pairs: the limit along the "
    "line between the two. Of many pairs the nearest are shown at first; touch a name to show or hide one."
)
_BARRIERS = "h of each member over its own pad since its landing began; below zero is unsafe outside the pad."
_TIMELINE = (
    "The whole log. Touch or point at a bar or an event to read it; bands in the figures below have the same "
    "colours."
)
_MARGIN = "With a margin of the robust filter, h may not fall below that line; over the pad the margin fades."
_TRACKING = (
    "Wanted: after filter and slew limit. Set-point: corrected for the vehicle's lag and disturbances "
    "(filter robust). Flown: velocity of the vehicle."
)
_VEHICLE = "True tilt of the body and voltage of the battery; a bar at the bottom while the motors are off."
_FILTER = (
    "Above: distance of u* from u', by barrier and admissible box. Below: slack of the barrier's constraint "
    "at u*; a negative slack violates it. The bar shows when this constraint changes the velocity; the "
    "robust filter also keeps the barrier by the box's lower limit of z."
)
_ERROR = "State used by the controller minus true state."
_TIMING = "Wall clock. A run in lockstep is as fast as the machine can: its period is not that of a flight."
_VELOCITY = (
    "Computed by the controller from its estimates. The bar at the bottom shows when the constraint of the "
    "barrier changed the command; the robust filter also keeps the barrier by the box's lower limit of z."
)
_SWITCH = " The vehicle's true velocity can be switched on in the legend."
_PLAN = "Circle: where the landing began. Triangle: first contact with the pad. Square, ring: end of the log."


def _barrier_source(flight: Flight) -> str:
    if flight.truth is None:
        return "h as the controller computed it from its estimates; the log holds no true states."
    return (
        "Solid: h from the true states, the lowest of the physics steps between two ticks. "
        "Dashed: h as the controller computed it."
    )
