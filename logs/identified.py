"""Identifies the parameters of the robust filter from flight logs: vehicle, target and links."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from flightstack.core.types import FilterStatus, Phase
from flightstack.identify import Link, Loop, Motion, Segment, link, motion, noise
from flightstack.identify import identify as fit
from logs.reader.flight_data import Flight, Floats, Steps

T = TypeVar("T")
FLYING = (Phase.TAKEOFF, Phase.APPROACH, Phase.LAND, Phase.HOLD, Phase.CLIMB)  # phases in the air
_NS = 1e-9


class Found(NamedTuple):
    """All identified parameters; ``None``: the logs do not determine the value, see ``missing``."""

    horizontal: Loop
    vertical: Loop
    # largest relative deviation of one log's lag from the common lag of the velocity loop, but at least two
    # relative standard errors of the common lag
    spread: float
    tracking_error_m_s: float | None
    own_noise_m: float | None
    link: Link | None
    motion: Motion | None
    missing: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the object that ``identify --json`` prints."""
        named = self._asdict()
        return {name: each._asdict() if hasattr(each, "_asdict") else each for name, each in named.items()}


def gather(flights: list[Flight]) -> Found:
    """Identify all parameters. Raises ValueError: the flights do not determine the velocity loop."""
    steps = [flight.steps for flight in flights if flight.steps is not None]
    if not steps:
        raise ValueError(f"{flights[0].path}: no controller steps; record a flight of the onboard process")
    period_s = float(np.median(np.concatenate([np.diff(s.t_s) for s in steps])))
    each = [_segments(s) for s in steps]
    horizontal = fit([seg for x, y, _ in each for seg in (*x, *y)], period_s, "horizontally")
    vertical = fit([seg for *_, z in each for seg in z], period_s, "vertically")
    spread = max(2.0 * loop.errors[4] / loop.lag_s for loop in (horizontal, vertical))
    missing: list[str] = []
    for number, (x, y, z) in enumerate(each if len(each) > 1 else ()):
        for loop, segments in ((horizontal, [*x, *y]), (vertical, z)):
            alone = _try(f"spread, log {number + 1}", missing, partial(fit, segments, period_s, "it alone"))
            if alone is not None:
                spread = max(spread, abs(alone.lag_s / loop.lag_s - 1.0))
    own = _try("own noise", missing, lambda: max(_own_noise_m(s) for s in steps))
    links = _try("target", missing, lambda: [link(*row) for row in _target(flights)])
    moved = links and _try(
        "target motion", missing, lambda: [motion(t, p) for t, _, p, _ in _target(flights)]
    )
    error = _try("tracking error", missing, lambda: _tracking_error_m_s(steps))
    return Found(
        horizontal, vertical, spread, error, own,
        max(links, key=lambda each: each.position_noise_m) if links else None,
        Motion(*map(max, zip(*moved, strict=True))) if moved else None,
        tuple(missing),
    )  # fmt: skip


def _try(what: str, missing: list[str], find: Callable[[], T]) -> T | None:
    """Return the result of ``find``; on ValueError, store its message in ``missing`` and return None.

    This function is not used for the velocity loop, whose result is required.
    """
    try:
        return find()
    except ValueError as error:
        missing.append(f"{what}: {error}")
        return None


def _segments(steps: Steps) -> list[list[Segment]]:
    """Return, for each axis, the intervals in flight with a set-point and a valid state in every tick."""
    command, flown = steps.command_enu_m_s, steps.own_velocity_enu_m_s
    good = steps.setpoint_sent & steps.own_valid & np.isin(steps.phase, FLYING)
    good &= np.isfinite(flown).all(1) & np.isfinite(command).all(1)
    starts = np.flatnonzero((np.diff(steps.tick) != 1) | (good[1:] != good[:-1])) + 1
    runs = [run for run in np.split(np.arange(len(good)), starts) if good[run[0]]]
    return [[Segment(command[run, axis], flown[run, axis]) for run in runs] for axis in range(3)]


def _own_noise_m(steps: Steps) -> float:
    """Return the noise of the vehicle's positions in flight, m, without states that a slow link repeats."""
    known = steps.own_valid & np.isin(steps.phase, FLYING) & np.isfinite(steps.own_position_enu_m).all(1)
    moved = np.any(np.diff(steps.own_position_enu_m, axis=0) != 0.0, axis=1)
    fresh = known & np.concatenate(([True], moved))
    return noise(steps.t_s[fresh], steps.own_position_enu_m[fresh])


def _target(flights: list[Flight]) -> list[tuple[Floats, Floats, Floats, Floats]]:
    """Return, for each log, stamps, arrivals, positions and velocities of its samples, ordered by stamp."""
    rows = []
    for target, origin_ns in ((each.target, each.origin_ns) for each in flights if each.target is not None):
        stamps, first = np.unique(target.stamp_ns, return_index=True)
        stamp_s = np.asarray((stamps - origin_ns) * _NS, dtype=np.float64)
        rows.append(
            (stamp_s, target.t_s[first], target.position_enu_m[first], target.velocity_child_m_s[first])
        )
    if not rows:
        raise ValueError("no odometry in the log")
    return rows


def _tracking_error_m_s(steps: list[Steps]) -> float:
    """Return the 95 % quantile of filtered minus flown vertical velocity in filtered ticks, m/s."""
    filtered = (FilterStatus.SOLVED, FilterStatus.CLOSED_FORM)
    short = []
    for s in steps:
        used = np.isin(s.filter_status, filtered) & np.isin(s.phase, (Phase.APPROACH, Phase.LAND))
        used &= s.setpoint_sent & s.own_valid
        short.append((s.filtered_enu_m_s - s.own_velocity_enu_m_s)[used, 2])
    together = np.concatenate(short)
    together = together[np.isfinite(together)]
    if len(together) < 100:
        raise ValueError(f"found {len(together)} filtered ticks, at least 100 are needed")
    return float(max(0.0, np.percentile(together, 95.0)))


def toml(found: Found, count: int) -> str:
    h, v = found.horizontal, found.vertical
    weights = (1.0 / max(h.errors[2], 1e-6) ** 2, 1.0 / max(v.errors[2], 1e-6) ** 2)
    damping, rate_z_1_s = (weights[0] * h.damping + weights[1] * v.damping) / sum(weights), v.model_rate_1_s
    late, model = h.model_dead_time_s, "of the model without dead time that has the same lag"
    if late:  # use the damping of the horizontal loop; the vertical lag is unchanged
        damping, rate_z_1_s, model = h.damping, 2.0 * h.damping / v.lag_s, "of the model"
    lines = [
        f"# identified from {count} log{'s' * (count > 1)}; +- one standard error",
        "[velocity_loop]",
        f"lag_xy_s = {h.lag_s:.3f}     # +- {h.errors[4]:.3f}",
        f"lag_z_s = {v.lag_s:.3f}      # +- {v.errors[4]:.3f}",
        f"dead_time_s = {late:.3f}  # part of lag_xy_s; 0: short enough for a model without",
        f"rate_xy_1_s = {h.model_rate_1_s:.2f}   # {model}",
        f"rate_z_1_s = {rate_z_1_s:.2f}",
        f"damping = {damping:.2f}       # horizontal {h.damping:.2f} +- {h.errors[2]:.2f}, "
        f"vertical {v.damping:.2f} +- {v.errors[2]:.2f}",
        *(f"# {name}: {_described(loop)}" for name, loop in (("horizontal", h), ("vertical", v))),
        "",
        "[envelope]",
        f"lag_spread = {found.spread:.2f} # seen here; other vehicles and batteries may differ more",
    ]
    link, motion = found.link, found.motion
    if link is not None:
        lines.append(f"target_rate_hz = {link.rate_hz:.0f}.0")
    if motion is not None:
        lines += [
            f"target_climb_max_m_s = {motion.climb_m_s:.2f}",
            f"target_acceleration_max_m_s2 = {motion.acceleration_m_s2:.2f}",
            f"# fastest horizontally: {motion.speed_m_s:.2f} m/s, for touchdown.target_speed_max_m_s",
        ]
    if found.own_noise_m is not None:
        lines += ["", "[own]", f"position_noise_m = {found.own_noise_m:.4f} # at least"]
    if link is not None:
        lines += [
            "", "[target]",
            *([] if link.delay_s is None else [f"delay_s = {link.delay_s:.3f} # if both clocks agree"]),
            f"position_noise_m = {max(1e-4, link.position_noise_m):.4f}",
            f"velocity_noise_m_s = {max(1e-4, link.velocity_noise_m_s):.4f}",
            f"# {100.0 * link.loss:.1f} % lost; 95 % are within {link.delay_spread_s:.3f} s of the fastest",
        ]  # fmt: skip
    if found.tracking_error_m_s is not None:
        lines += ["", "[robust]", f"tracking_error_m_s = {found.tracking_error_m_s:.3f} # 95 % stay below"]
    lines += [f"# not found: {reason}" for reason in found.missing]
    return "\n".join(lines) + "\n"


def _described(loop: Loop) -> str:
    gain, rate, damping, dead, _ = loop.errors
    return (
        f"gain {loop.gain:.3f} +- {gain:.3f}, rate {loop.rate_1_s:.2f} +- {rate:.2f} 1/s, damping "
        f"{loop.damping:.2f} +- {damping:.2f}, dead time {1000.0 * loop.dead_time_s:.0f} +- "
        f"{1000.0 * dead:.0f} ms; {100.0 * loop.explained:.0f} % of {loop.time_s:.0f} s explained"
    )
