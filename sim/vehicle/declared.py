"""Checks that the values declared in a configuration (robot, pad, links, wind and others) fit its scenario.

The certificate proves a configuration for the declared values. These checks compare the declared values with
the scenario, so that the proof is valid for flights in this scenario.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from operator import attrgetter
from typing import NamedTuple

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import own_boundary
from flightstack.verify.certificate import checks
from flightstack.verify.envelope import extremes
from flightstack.verify.fleet import team_checks
from flightstack.verify.paper import touch_height
from flightstack.verify.robust import HELD_M
from flightstack.verify.touchdown import farthest_m
from flightstack.verify.types import Check, Need
from logs.verdict.verdict import two_barriers
from sim.plant.params import load
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import PathKind, StartKind, TargetSpec
from sim.vehicle.judge import Shape
from sim.world.step import DIAGONAL

DELAY_M_S = 0.02  # allowed difference between declared and simulated delay, s; its effect is below the noise
NOISE_SHARE = 0.5  # minimum ratio of declared to simulated noise of a link; an estimator filters noise
SPEED_SHARE = 0.01  # allowed relative excess of the target's acceleration over the declared value
# minimum ratio of the declared vertical velocity error to the gusts' rms: that of tier lab
GUST_SHARE = 0.066
RADIO_SHARE = 0.5  # maximum ratio of the radio's delay to the declared lag spread
# Fraction of the certificate's bound on the touchdown distance; at this distance all feet must be on the pad.
# Of 300 landings of tier lab 19 crash on a pad of 6 cm, 3 on 7 cm, none on 8 cm; half of the bound fits 8 cm.
FEET_SHARE = 0.5
TOUCH_STEP_M = 0.001  # step at which the boundary is compared with the height of a touchdown, m
STEP_M, FAR_M = 0.005, 10.0  # step and largest distance at which the barriers are compared, m


class _Row(NamedTuple):
    """Comparison of a value that the configuration declares with the value of the scenario."""

    key: str  # key in the configuration, TABLE.KEY
    there: str  # key in the scenario, or a text that names several
    unit: str
    found: float | None = None  # value in the scenario; None: the value of the key ``there``
    share: float = 1.0  # minimum ratio of the declared value to the value in the scenario
    near: float | None = None  # maximum allowed difference; None: the declared value may be larger
    room: float | None = None  # margin; None: it follows from ``share`` or ``near``
    remedy: str = ""  # change that makes this margin positive

    def check(self, scenario: Scenario) -> Check:
        declared = float(attrgetter(self.key)(scenario.onboard))
        found = float(attrgetter(self.there)(scenario)) if self.found is None else self.found
        needed = self.share * found
        room = declared - needed
        change = f"to {_rounded_up(needed):g} or more, or lower {self.there.rstrip(',')}"
        if self.near is not None:
            room, change = self.near - abs(declared - found), f"to {found:.3g}"
        return _check(
            self.key, f"the configuration declares the values of the scenario ({self.there})",
            (room if self.room is None else self.room) + 1e-12, self.unit,
            f"onboard.{self.key} is {declared:.3g}, {self.there} is {found:.3g}",
            self.remedy or f"set onboard.{self.key} {change}",
        )  # fmt: skip


def _check(name: str, what: str, room: float, unit: str, worst: str, remedy: str) -> Check:
    return Check(f"declared, {name}", what, room, unit, worst, remedy, Need.PROOF)


def declared(scenario: Scenario) -> list[Check]:
    """Return the checks of a scenario, in addition to those of its configuration."""
    rows = [row.check(scenario) for row in _rows(scenario)]
    return [*rows, _judged(scenario), _feet(scenario), _starts(scenario), *_flown(scenario)]


def outside(scenarios: Iterable[Scenario]) -> str:
    """Return keys and values with which scenarios exceed their configuration's proof; empty: none."""
    found = dict.fromkeys(check.worst for each in scenarios for check in declared(each) if not check.proven)
    return "; ".join(found)


def judged_apart(scenario: Scenario) -> str:
    """Return a text that names the barriers of verdict and flight; empty if they are equal."""
    judge, flown = (
        (shape.alpha_1_m, shape.beta_m) for shape in (scenario.judged_by, scenario.onboard.barrier)
    )
    apart = two_barriers(judge, flown) if judge != flown else ""
    return "; ".join(filter(None, (apart, own_boundary(scenario.onboard.filter))))


def not_proven(scenario: Scenario) -> str:
    """Return one line that names the checks not proven for these scenarios; empty if all are proven."""
    found = dict.fromkeys(
        check.name
        for each in scenario.members
        for check in (*checks(each.onboard), *declared(each))
        if not check.proven
    )
    return f"not proven for this scenario (flightstack check): {', '.join(found)}" if found else ""


def _rounded_up(value: float) -> float:
    """Return a positive value, rounded up to three digits."""
    if value <= 0.0:
        return value
    digits = 2 - math.floor(math.log10(value))
    return math.ceil(value * 10.0**digits - 1e-9) / 10.0**digits


def _rows(scenario: Scenario) -> list[_Row]:
    """Return comparisons of robot, feet and altitude; with a robust filter also of vehicle and links."""
    config, target, start, spec = scenario.onboard, scenario.target, scenario.start, scenario.vehicle
    drawn_m = start.h_m[1] + scenario.judged_by.peak_height_m
    rows = [
        _Row("touchdown.target_speed_max_m_s", "target.speed_m_s", "m/s"),
        _Row("touchdown.feet_below_reference_m", "vehicle.airframe", "m",
             -load(spec.airframe).geometry.foot_bottom_m, near=config.contact.gap_m),
        _Row("envelope.target_acceleration_max_m_s2",
             "target.acceleration_max_m_s2, speed_m_s times turn_rate_rad_s, or heave", "m/s^2",
             _acceleration_m_s2(target), 1.0 / (1.0 + SPEED_SHARE)),
        _Row("limits.altitude_max_m", "start.offset_m or start.h_m, above the pad,", "m",
             drawn_m if start.offset_m is None else start.offset_m[2]),
    ]  # fmt: skip
    if config.filter == "paper":  # the paper's filter declares no vehicle, wind or links
        return rows
    radio_s = RADIO_SHARE * config.envelope.lag_spread * config.velocity_loop.lag_xy_s
    link_hz = scenario.odometry.rate_hz
    rows += [
        _Row("robust.tracking_error_m_s", "wind.gust_rms_m_s", "m/s", share=GUST_SHARE),
        _Row("envelope.lag_spread", "vehicle.motor_lag_spread, or mass_spread plus thrust_spread,", "",
             max(spec.motor_lag_spread, spec.mass_spread + spec.thrust_spread)),
        _Row("velocity_loop.lag_xy_s",
             f"at most {radio_s:.3g} s of it may be the radio's, vehicle.setpoint_delay_s", "s",
             spec.setpoint_delay_s, room=radio_s - spec.setpoint_delay_s,
             remedy=f"lower vehicle.setpoint_delay_s to {radio_s:g} or less, or identify the loop with the "
                    "radio (flightstack identify)"),
        _Row("envelope.target_climb_max_m_s", "target.heave_amplitude_m times 2 pi heave_rate_hz", "m/s",
             math.tau * target.heave_rate_hz * target.heave_amplitude_m),
        _Row("envelope.target_rate_hz", "odometry.rate_hz", "Hz",
             room=link_hz - config.envelope.target_rate_hz,
             remedy=f"set onboard.envelope.target_rate_hz to {link_hz:g} or less, or raise odometry.rate_hz"),
    ]  # fmt: skip
    # each: errors of a link, table of the configuration, tables of the scenario for noise and for errors
    links = (
        (scenario.odometry.error, "target", "odometry", "odometry.error"),
        (spec.own, "own", "vehicle.mocap", "vehicle.own"),
    )
    for error, table, link, errors in links:
        if error is not None:
            rows.append(_Row(f"{table}.delay_s", f"{errors}.delay_s", "s", near=DELAY_M_S))
            continue
        rows.append(_Row(f"{table}.delay_s", f"{link}.delay_s", "s", near=DELAY_M_S))
        rows.append(_Row(f"{table}.position_noise_m", f"{link}.position_noise_m", "m", share=NOISE_SHARE))
        if table == "target":
            key = "velocity_noise_m_s"
            rows.append(_Row(f"{table}.{key}", f"{link}.{key}", "m/s", share=NOISE_SHARE))
    return rows


def _judged(scenario: Scenario) -> Check:
    """Return the check that the verdict's boundary is nowhere above the flown boundary outside the pad."""
    flown, judge = scenario.onboard.barrier, scenario.judged_by
    distances = (scenario.target.pad_radius_m + k * STEP_M for k in range(int(FAR_M / STEP_M)))
    below_m, at_m = max((judge.height(d) - flown.height(d), d) for d in distances)
    return _check(
        "barrier", "the barrier that is flown is nowhere below that of the verdict (judge)",
        HELD_M - below_m, "m",
        f"onboard.barrier is {1000.0 * below_m:.3g} mm below judge at {at_m:.3g} m from the landing spot",
        "remove the table [judge]: the verdict then uses the barrier that is flown",
    )  # fmt: skip


def _feet(scenario: Scenario) -> Check:
    """Return the check that the pad has room for the feet at the assumed distance of a touchdown.

    The certificate bounds the distance of the vehicle's centre from the middle of the pad. A pad with room
    for the feet at the whole bound is larger than the pads of the tiers, on which campaigns land.
    ``_reach_m`` therefore assumes a smaller distance.
    """
    geometry, pad_m = load(scenario.vehicle.airframe).geometry, scenario.target.pad_radius_m
    foot_m, (reach_m, where) = DIAGONAL * geometry.foot_offset_m, _reach_m(scenario.onboard)
    needed_m = foot_m + reach_m
    return _check(
        "feet", "the pad has room for all feet around the usual places of a touchdown",
        pad_m - needed_m, "m",
        f"the feet are {1000.0 * foot_m:.3g} mm from the vehicle's centre, and the touchdown needs "
        f"{1000.0 * reach_m:.3g} mm ({where}); the pad has {1000.0 * pad_m:g} mm",
        f"set target.pad_radius_m to {_rounded_up(needed_m):g} or more",
    )  # fmt: skip


def _reach_m(config: FlightConfig) -> tuple[float, str]:
    """Return the assumed distance of a touchdown from the pad's centre, m, and the name of its source."""
    if config.filter == "paper":
        (key, touch_m), barrier = touch_height(config), config.barrier
        steps = range(math.ceil(config.touchdown.pad_radius_m / TOUCH_STEP_M) + 1)
        above = (k * TOUCH_STEP_M for k in steps if barrier.height(k * TOUCH_STEP_M) >= touch_m)
        return next(above, config.touchdown.pad_radius_m), f"there the boundary reaches {key}"
    commit_m = config.robust.commit_radius_m
    bound_m = farthest_m(config.descending, extremes(config))[0]
    # the check drift reports a bound beyond the pad
    if commit_m < FEET_SHARE * bound_m and bound_m <= config.touchdown.pad_radius_m:
        return FEET_SHARE * bound_m, "half of the bound of the check drift"
    return commit_m, "robust.commit_radius_m"


def _starts(scenario: Scenario) -> Check:
    offset_m = scenario.start.offset_m
    starts_m = scenario.start.h_m[0] if offset_m is None else scenario.judged_by.h(offset_m)
    if scenario.start.kind is not StartKind.HOVER:
        starts_m = math.inf  # the vehicle takes off from the floor
    return _check(
        "start", "the vehicle starts above the barrier", starts_m, "m", f"start: h is {starts_m:.3g} m",
        "raise start.h_m or start.offset_m: below the barrier it only recovers",
    )  # fmt: skip


def _flown(scenario: Scenario) -> list[Check]:
    """Return the checks that values without a key in the configuration are no worse than in the tiers."""
    link, spec, wind = scenario.odometry, scenario.vehicle, scenario.wind
    mocap, charge = spec.mocap, spec.battery_charge[0]
    discharged = 0.08 if scenario.onboard.reserve is not None else 1.0  # only tier room has low batteries
    # key, value, worst value in a tier, unit; comment: the tier; negative values if a smaller value is worse
    rows = [
        ("wind.mean_m_s", wind.mean_m_s, 2.0, "m/s"),  # storm
        ("odometry.loss", link.loss, 0.2, ""),  # storm
        ("odometry.dropout_max_s", link.dropout_max_s, 0.3, "s"),  # storm
        ("odometry.yaw_noise_rad", link.yaw_noise_rad, 0.01, "rad"),  # large
        ("vehicle.mocap.rate_hz", -mocap.rate_hz, -50.0, "Hz"),  # storm
        ("vehicle.mocap.loss", mocap.loss, 0.0, ""),
        ("vehicle.mocap.dropout_max_s", mocap.dropout_max_s, 0.0, "s"),
        ("vehicle.mocap.yaw_noise_rad", mocap.yaw_noise_rad, 0.01, "rad"),  # large
        ("vehicle.motor_spread", spec.motor_spread, 0.1, ""),  # room
        ("vehicle.battery_charge", -charge, -discharged, ""),
        ("vehicle.slow_motors", float(spec.slow_motors), 0.0, ""),
        ("vehicle.ground_effect_gain", spec.ground_effect_gain, 1.0, ""),
    ]
    return [
        _check(
            key, "the scenario is no worse here than the tiers, of which the campaigns show that they land",
            most - value, unit,
            f"{key}: {abs(value):g}, flown {'up' if most >= 0.0 else 'down'} to {abs(most):g}",
            f"{'lower' if most >= 0.0 else 'raise'} {key}",
        )
        for key, value, most, unit in rows
    ]  # fmt: skip


def _acceleration_m_s2(target: TargetSpec) -> float:
    """Return the largest acceleration of the pad, m/s^2: along the path, across the path, or vertical."""
    speed_m_s = target.speed_m_s
    turn_rad_s = abs(target.turn_rate_rad_s)
    turns_m_s2 = turn_rad_s * (speed_m_s + turn_rad_s * abs(target.pad_behind_axle_m))
    even = (PathKind.STRAIGHT, PathKind.CIRCLE, PathKind.FIGURE_OF_EIGHT)
    steady = target.path in even and not target.wait_for_landing
    brakes_m_s2 = 0.0 if steady or speed_m_s == 0.0 else target.acceleration_max_m_s2
    heaves_m_s2 = (math.tau * target.heave_rate_hz) ** 2 * target.heave_amplitude_m
    return max(math.hypot(brakes_m_s2, turns_m_s2), heaves_m_s2)


def crowd(scenario: Scenario) -> list[Check]:
    """Return the checks of all vehicles together; empty for a single vehicle."""
    shapes = [Shape.of(load(each.vehicle.airframe)) for each in scenario.members]
    radius_m = 2.0 * max(shape.radius_m for shape in shapes)
    up_m = max(shape.top_m for shape in shapes) - min(shape.bottom_m for shape in shapes)
    configs = [each.onboard for each in scenario.members]
    return team_checks(configs, scenario.starts_enu_m(), (radius_m, 0.0, up_m), scenario.pads_apart_m())
