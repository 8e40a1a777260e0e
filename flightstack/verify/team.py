"""Checks of a fleet as a whole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

from flightstack.core.fleet.ellipsoid import barrier
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.robust import RobustFilter
from flightstack.core.strategies.strategy import strategy_class
from flightstack.core.types import Vec3
from flightstack.verify.envelope import extremes
from flightstack.verify.fleet import errors_m
from flightstack.verify.types import Check, Need


def team_checks(
    configs: Sequence[FlightConfig], starts_enu_m: Sequence[Vec3], touch_m: Vec3, pads_apart_m: float
) -> list[Check]:
    """Return the checks that involve all members.

    ``configs``: configurations of the members, each with a table [fleet]; ``starts_enu_m``: known start
    places in the air; ``touch_m``: largest offset of two vehicles at which they overlap; ``pads_apart_m``:
    least distance of any two pads.
    """
    fleets = [config.fleet for config in configs if config.fleet is not None]
    return [
        one_table(fleets),
        *([begin(fleets[0], starts_enu_m)] if len(starts_enu_m) > 1 else []),
        pads(configs[0], fleets[0], pads_apart_m),
        contact(configs, touch_m),
    ]


def one_table(fleets: Sequence[Fleet]) -> Check:
    first, ids = fleets[0], sorted(fleet.id for fleet in fleets)
    keys = [field.name for field in fields(Fleet) if field.name not in ("id", "members")]
    other = [k for k in keys if any(getattr(each, k) != getattr(first, k) for each in fleets)]
    other += ["members"] if any(sorted(each.members) != ids for each in fleets) else []
    return Check(
        "one table",
        "all members have the same table [fleet], with exactly the members of the team",
        0.0 - len(other),
        "keys",
        f"{len(fleets)} members; different keys: {', '.join(other) or 'none'}",
        f"give all members the same fleet.{', fleet.'.join(other)}" if other else "",
        Need.PROOF,
    )


def begin(fleet: Fleet, starts_enu_m: Sequence[Vec3]) -> Check:
    least_m, where = math.inf, (0, 0)
    for i, (x, y, z) in enumerate(starts_enu_m):
        for j, (ox, oy, oz) in enumerate(starts_enu_m[:i]):
            h_m, _ = barrier((x - ox, y - oy, z - oz), fleet.radius_xy_m, fleet.radius_z_m)
            if h_m < least_m:
                least_m, where = h_m, (j + 1, i + 1)
    return Check(
        "starts",
        "no vehicle starts inside the ellipsoid around another one",
        least_m,
        "m",
        f"members {where[0]} and {where[1]} are nearest to each other",
        "give them other start positions",
        Need.PROOF,
    )


def pads(config: FlightConfig, fleet: Fleet, apart_m: float) -> Check:
    if issubclass(strategy_class(config.filter), RobustFilter):
        x = extremes(config)
        velocity_m_s, position_m = x.velocity_error_m_s, x.position_error_m
    else:
        factor, link = config.robust.sigma_factor, config.target
        velocity_m_s, position_m = factor * link.velocity_noise_m_s, factor * link.position_noise_m
    error_m = 2.0 * (position_m + velocity_m_s * fleet.descent_s)
    return Check(
        "pads",
        "no two pads are predicted to conflict, so no member waits",
        apart_m - error_m - fleet.pad_distance_m,
        "m",
        (f"paths remain {apart_m:.3g} m apart, " if apart_m > 0.0 else "paths may meet, ")
        + f"fleet.pad_distance_m is {fleet.pad_distance_m:g}; velocity errors of {velocity_m_s:.3g} m/s "
        f"each add {error_m:.3g} m within fleet.descent_s",
        "drive the robots farther apart, or lower fleet.pad_distance_m or fleet.descent_s",
        Need.PROOF,
    )


def contact(configs: Sequence[FlightConfig], touch_m: Vec3) -> Check:
    rooms = []
    for config in configs:
        if (fleet := config.fleet) is not None:
            touch_h_m, _ = barrier(touch_m, fleet.radius_xy_m, fleet.radius_z_m)
            lost_m = max(0.0, errors_m(config, fleet) - fleet.margin_m)
            rooms.append(
                (-touch_h_m - lost_m, touch_h_m, lost_m, fleet.rate_1_s * (fleet.margin_m - touch_h_m))
            )
    room_m, touch_h_m, lost_m, allowed_m_s = min(rooms)
    return Check(
        "contact",
        "two vehicles that meet their rows do not touch, in spite of velocity errors",
        room_m,
        "m",
        f"errors of robust.tracking_error_m_s, in any direction, reduce h to -{lost_m:.3g} m; the shapes "
        f"touch at {touch_h_m:.3g} m; together, errors of {allowed_m_s:.3g} m/s are allowed",
        "raise fleet.margin_m, fleet.radius_xy_m or fleet.rate_1_s",
        Need.PROOF,
    )
