"""Curves of a flight over time, for the report and Rerun: a chart has rows, and a row has curves.

The colours are from Okabe and Ito (2008): colour-blind readers can distinguish them, also in a grey-scale
print. A colour has the same meaning in every chart; the curves of true and estimated values also have
different line styles.
"""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from flightstack.core.strategies.strategy import packaged_strategy_of
from flightstack.core.types import FilterStatus
from logs.reader.flight_data import Bools, Flight, Floats, Steps, Truth
from logs.verdict.types import VIOLATION_LIMIT_M

TRUE = "#0072B2"  # blue: true values
ESTIMATED = "#56B4E9"  # sky blue: estimated values
TARGET = "#CC79A7"  # reddish purple: target
BOUNDARY = "#D55E00"  # vermillion: boundary h = 0
NOMINAL = "#E69F00"  # orange: nominal velocity
FILTERED = "#0072B2"
COMMAND = "#009E73"  # bluish green: commanded velocity
LIMIT = "#666666"
INK = "#1f2933"
FLOWN = "#882255"  # wine: velocity of the vehicle; true in the report, estimated in the 3-D view
AXES = ("x", "y", "z")

_RAN = (
    FilterStatus.SOLVED,
    FilterStatus.CLOSED_FORM,
    FilterStatus.INFEASIBLE,
    FilterStatus.CROWDED,
    FilterStatus.OWN,
)
_NEAR_S = 0.02  # maximum time between a step and its true state, s: two ticks
_MARGIN_SEEN_M = 1e-4  # minimum margin that is drawn, m; a smaller margin is a rounding error
_WALL_US = [m * 10**n for n in range(6) for m in (1, 2, 5)]  # marks on the axis of computation times, us

Values = tuple[Floats, Floats]  # times since the origin of the flight, s, and values; NaN: a gap


class Curve(NamedTuple):
    key: str
    name: str  # name in the legend
    color: str
    values: Callable[[Flight], Values | None]  # returns None if the log has no such data
    width: float = 1.5
    dash: str = "solid"
    symbol: str = ""  # symbol of the markers that replace the line; only the report draws them
    hidden: bool = False  # whether the report shows the curve only after a click on its name in the legend


class Row(NamedTuple):
    key: str
    title: str  # quantity and unit
    curves: tuple[Curve, ...]
    axis: Any = MappingProxyType({})  # plotly options of the y axis; empty: zero and all values are visible
    lowest: bool = False  # whether a thinned curve keeps the smallest value of each block of samples


class Chart(NamedTuple):
    key: str
    title: str
    note: str
    height_px: int
    rows: tuple[Row, ...]
    paper: str = ""  # number of the figure in the paper with the same content


def held_margin_m(flight: Flight) -> Floats | None:
    """Return the margin on h, m, that the filter enforced at each step, (n,); NaN if the filter did not run.

    A step contains the slack s of the constraint at u*: s = g u* + rate * h_held + dh/dt. This gives h_held,
    and the margin is h - h_held. The result is ``None`` without steps, without configuration, and for a
    filter that is not part of the package.
    """
    steps, config = flight.steps, flight.config
    if steps is None or config is None:
        return None
    strategy = packaged_strategy_of(config)
    if strategy is None:
        return None
    flow = np.einsum("ij,ij->i", steps.gradient, steps.filtered_enu_m_s)
    held_m = (steps.slack_m_s - flow - steps.dh_dt_m_s) / strategy.rate_1_s
    margin_m = np.where(np.isin(steps.filter_status, _RAN), steps.h_m - held_m, np.nan)
    return margin_m if np.isfinite(margin_m).any() else None


def estimate_errors(flight: Flight) -> dict[str, Floats] | None:
    """Return estimates minus true states at the n controller steps, m, by name; ``None`` without true states.

    Arrays are (n, 3) for "vehicle" and "target", (n, 1) for "h"; unknown values are NaN. True states are
    interpolated linearly.
    """
    steps, truth = flight.steps, flight.truth
    if steps is None or truth is None or len(truth.t_s) < 2:
        return None
    right = np.clip(np.searchsorted(truth.t_s, steps.t_s), 1, len(truth.t_s) - 1)
    gap_s = np.minimum(*(np.abs(truth.t_s[at] - steps.t_s) for at in (right - 1, right)))

    def error(valid: Bools, estimate: Floats, true: Floats) -> Floats:
        at_steps = np.column_stack([np.interp(steps.t_s, truth.t_s, column) for column in true.T])
        return np.where((valid & (gap_s <= _NEAR_S))[:, None], estimate - at_steps, np.nan)

    return {
        "vehicle": error(steps.own_valid, steps.own_position_enu_m, truth.position_enu_m),
        "target": error(steps.target_valid, steps.target_position_enu_m, truth.pad_position_enu_m),
        "h": error(steps.both_valid, steps.h_m[:, None], truth.h_m[:, None]),
    }


def sent_m_s(steps: Steps) -> Floats:
    return np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)


def flown_m_s(steps: Steps) -> Floats:
    return np.where(steps.own_valid[:, None], steps.own_velocity_enu_m_s, np.nan)


def _of(part: str, value: Callable[[Any], Any]) -> Callable[[Flight], Values | None]:
    """Return the source of a curve: a function that gets a value from each row of this part of a flight."""

    def values(flight: Flight) -> Values | None:
        rows = getattr(flight, part)
        return None if rows is None else (rows.t_s, np.asarray(value(rows), dtype=np.float64))

    return values


def _constant(value: Callable[[Flight], float | None]) -> Callable[[Flight], Values | None]:
    def values(flight: Flight) -> Values | None:
        found = None if flight.steps is None else value(flight)
        return None if found is None else (np.array([0.0, flight.duration_s]), np.full(2, found))

    return values


def _margin(flight: Flight) -> Values | None:
    margin_m = held_margin_m(flight)
    if margin_m is None or flight.steps is None or not np.nanmax(margin_m) > _MARGIN_SEEN_M:
        return None
    return flight.steps.t_s, margin_m


def _lowest(flight: Flight) -> Values | None:
    """Return the lowest h outside the pad since the landing began, with its time."""
    steps, truth = flight.steps, flight.truth
    if truth is not None:
        t_s, h_m = truth.t_s, truth.h_min_outside_pad_m
    elif steps is not None:
        t_s, h_m = steps.t_s, np.where(steps.d_m > flight.pad_radius_m, steps.h_m, np.nan)
    else:
        return None
    known = np.where(np.isfinite(h_m) & (t_s > (flight.landing_start_s or 0.0)), h_m, np.inf)
    at = np.argmin(known, keepdims=True)
    return (t_s[at], h_m[at]) if np.isfinite(known[at]).all() else None


def _tilt_deg(truth: Truth) -> Floats:
    """Return the true angle between body z and the vertical, degrees, (n,)."""
    x, y = truth.orientation[:, 0], truth.orientation[:, 1]
    return np.asarray(np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))))


def _status(status: FilterStatus, name: str, symbol: str) -> Curve:
    def at(steps: Steps) -> Floats:
        return np.where(steps.filter_status == status, np.nan_to_num(steps.slack_m_s), np.nan)

    return Curve(status.name.lower(), name, BOUNDARY, _of("steps", at), symbol=symbol)


def _rises(values: Any, at: Any) -> Floats:
    """Return the values of ``at`` where a count has increased, else NaN."""
    return np.where(np.diff(values, prepend=values[:1]) > 0, at, np.nan)


def _velocity(axis: int) -> Row:
    def limit(sign: float) -> Callable[[Flight], float | None]:
        return lambda f: None if f.config is None else sign * f.config.limits.velocity_max_m_s[axis]

    def steps(value: Callable[[Steps], Floats]) -> Callable[[Flight], Values | None]:
        return _of("steps", lambda s: value(s)[:, axis])

    return Row(AXES[axis], f"{('x, east', 'y, north', 'z, up')[axis]} [m/s]", (
        Curve("nominal", "nominal u'", NOMINAL, steps(lambda s: s.nominal_enu_m_s), 1.6, "dash"),
        Curve("filtered", "filtered u*", FILTERED, steps(lambda s: s.filtered_enu_m_s), 2.4),
        Curve("wanted", "wanted, after slew limit", INK, steps(lambda s: s.wanted_enu_m_s), hidden=True),
        Curve("sent", "sent set-point", COMMAND, steps(sent_m_s), 2.0, "dot"),
        Curve("flown", "flown, by its own estimate", ESTIMATED, steps(flown_m_s), 1.3),
        Curve("true", "flown (true)", FLOWN, _of("truth", lambda s: s.velocity_enu_m_s[:, axis]), 1.3,
              hidden=True),
        Curve("box", "admissible box", LIMIT, _constant(limit(1.0)), 1.0, "dashdot"),
        Curve("box_low", "admissible box, low", LIMIT, _constant(limit(-1.0)), 1.0, "dashdot"),
    ))  # fmt: skip


def _error(key: str, *curves: tuple[str, str]) -> Row:
    def values(axis: int) -> Callable[[Flight], Values | None]:
        def of(flight: Flight) -> Values | None:
            steps, errors = flight.steps, estimate_errors(flight)
            return None if steps is None or errors is None else (steps.t_s, 1e3 * errors[key][:, axis])

        return of

    return Row(key, f"{key} [mm]", tuple(
        Curve(name, name, color, values(axis)) for axis, (name, color) in enumerate(curves)
    ))  # fmt: skip


_ENU = (("east", NOMINAL), ("north", TRUE), ("up", COMMAND))


def _age_limit(name: str) -> Callable[[Flight], Values | None]:
    return _constant(lambda f: None if f.config is None else 1e3 * getattr(f.config.checks, name))


CHARTS = (
    Chart("barrier", "Barrier value over time",
          "h from the true states, the lowest of the physics steps between two ticks, and h as the "
          "controller computed it. Dotted: −5 mm, the limit of a violation outside the pad. With a margin of "
          "the robust filter, h may not fall below that line; over the pad the margin fades.", 560, (
        Row("h", "h [m]", (
            Curve("true", "h (true, lowest between ticks)", TRUE, _of("truth", lambda s: s.h_min_m), 2.2),
            Curve("estimate", "h (estimate)", ESTIMATED, _of("steps", lambda s: s.h_m), dash="dash"),
            Curve("margin", "margin: lower limit of h", NOMINAL, _margin, 2.0),
            Curve("zero", "h = 0", BOUNDARY, _constant(lambda _: 0.0), 1.8),
            Curve("limit", "violation", BOUNDARY, _constant(lambda _: VIOLATION_LIMIT_M), 1.0, "dot"),
            Curve("lowest", "lowest outside the pad", INK, _lowest, symbol="triangle-down"),
        ), lowest=True),
        Row("distance", "to the pad [m]", (
            Curve("horizontal", "horizontal distance d", TARGET, _of("steps", lambda s: s.d_m)),
            Curve("height", "height e_z", COMMAND, _of("steps", lambda s: s.e_m[:, 2])),
        )),
    ), "Fig. 9a, 13a"),
    Chart("velocity", "Velocity: nominal, filtered, sent, flown",
          "Computed by the controller from its estimates. Wanted: after filter and slew limit. Sent: "
          "corrected for lag and disturbances (filter robust). The wanted and the true velocity "
          "can be switched on in the legend.", 800, tuple(map(_velocity, range(3))), "Fig. 9b–d, 13b–d"),
    Chart("filter", "What the filter does",
          "Above: distance of u* from u', by barrier and admissible box. Middle: slack of the barrier's "
          "constraint at u*; a negative slack violates it. The bar shows when this constraint changes the "
          "velocity; the robust filter also keeps the barrier by the box's lower limit of z.", 620, (
        Row("change", "change [m/s]", (
            Curve("change", "change |u* − u'|", FILTERED, _of("steps", lambda s: np.where(
                np.isfinite(s.slack_m_s), np.linalg.norm(s.filtered_enu_m_s - s.nominal_enu_m_s, axis=1),
                np.nan)), 1.8),
        )),
        Row("slack", "slack [m/s]", (
            Curve("slack", "slack of the constraint at u*", COMMAND, _of("steps", lambda s: s.slack_m_s)),
            Curve("active", "barrier active", BOUNDARY,
                  _of("steps", lambda s: np.where(s.barrier_active, 0.0, np.nan)), 5.0),
            _status(FilterStatus.CLOSED_FORM, "exact projection used", "circle"),
            _status(FilterStatus.INFEASIBLE, "no velocity satisfies it", "x"),
            _status(FilterStatus.REJECTED, "nothing usable", "cross"),
            _status(FilterStatus.CROWDED, "constraints of other vehicles relaxed", "triangle-up"),
        )),
        Row("motion", "∂h/∂t [m/s]", (
            Curve("dh_dt", "∂h/∂t, motion of the target", TARGET, _of("steps", lambda s: s.dh_dt_m_s)),
        )),
    )),
    Chart("error", "Error of the estimates", "State used by the controller minus true state.", 640, (
        _error("vehicle", *_ENU), _error("target", *_ENU), _error("h", ("h", INK)),
    )),
    Chart("vehicle", "The vehicle", "True tilt of the body and voltage of the battery; a bar at the bottom "
          "while the motors are off.", 420, (
        Row("tilt", "tilt [°]", (
            Curve("tilt", "tilt", TRUE, _of("truth", _tilt_deg)),
            Curve("off", "motors off", LIMIT,
                  _of("truth", lambda s: np.where(s.motors_running, np.nan, 0.0)), 5.0),
        )),
        Row("battery", "battery [V]", (
            Curve("battery", "battery", TARGET, _of("truth", lambda s: s.battery_v)),
        ), {"autorange": True}),
    )),
    Chart("timing", "Loop timing", "Wall clock. A run in lockstep is as fast as the machine can: its period "
          "is not that of a flight.", 480, (
        Row("period", "period [ms]", (
            Curve("period", "period", TRUE, _of("timing", lambda s: 1e3 * s.period_s), 1.2),
            Curve("overruns", "overrun", BOUNDARY,
                  _of("timing", lambda s: _rises(s.overruns, 1e3 * s.period_s)), symbol="x"),
        )),
        Row("wall", "wall time [µs]", (
            Curve("exec", "whole tick", COMMAND, _of("timing", lambda s: 1e6 * s.exec_s)),
            Curve("solve", "quadratic program", NOMINAL,  # 0: the program did not run
                  _of("timing", lambda s: np.where(s.solve_s > 0.0, 1e6 * s.solve_s, np.nan))),
            Curve("late", "start after deadline", LIMIT, _of("timing", lambda s: 1e6 * s.lateness_s),
                  1.0, hidden=True),
        ), {"type": "log", "tickvals": _WALL_US}),
    )),
    Chart("age", "Age of the data at each tick", "As the controller saw it, with the limits of the "
          "configuration; below, the samples of the target so far.", 520, (
        Row("age", "age at the tick [ms]", (
            Curve("target", "target state", TARGET, _of("steps", lambda s: 1e3 * s.target_age_s)),
            Curve("own", "own state", TRUE, _of("steps", lambda s: 1e3 * s.own_age_s)),
            Curve("target_limit", "limit, target", TARGET, _age_limit("target_age_max_s"), 1.0, "dash"),
            Curve("own_limit", "limit, own", TRUE, _age_limit("own_age_max_s"), 1.0, "dash"),
            Curve("refused", "sample refused", BOUNDARY,
                  _of("steps", lambda s: _rises(s.target_rejected, 0.0)), symbol="x"),
        )),
        Row("samples", "target samples", (
            Curve("accepted", "accepted", COMMAND, _of("steps", lambda s: s.target_accepted)),
            Curve("rejected", "refused", BOUNDARY, _of("steps", lambda s: s.target_rejected)),
        )),
    )),
)  # fmt: skip
