"""Checks that a configuration declares robot, pad, links, barrier, start, wind and vehicle of its scenario.

The certificate proves a configuration for what it declares. These checks compare its declarations with the
scenario, so that a proof applies to the flight.
"""

from __future__ import annotations

import math

from flightstack.core.safety.barrier import Barrier
from flightstack.verify.certificate import checks
from flightstack.verify.robust import HELD_M
from flightstack.verify.team import team_checks
from flightstack.verify.types import Check, Need
from sim.plant.params import load
from sim.scenarios.scenario import PathKind, Scenario, StartKind, TargetSpec
from sim.scenarios.team import TeamScenario
from sim.vehicle.encounters import Shape

DELAY_M_S = 0.02  # s; allowed difference of a declared delay, within the errors of the noise
NOISE_SHARE = 0.5  # least declared share of a link's noise, which an estimator filters
SPEED_SHARE = 0.01  # of a declared speed or acceleration; within the errors of both
# of the gusts' rms: least declared error of the vertical velocity; the lowest of the tiers, in lab
GUST_SHARE = 0.066
WIND_FLOWN_M_S = 2.0  # strongest mean wind of the tiers, storm
RADIO_SHARE = 0.5  # of the declared spread of the lag, which the radio's delay may take
STEP_M, FAR_M = 0.005, 10.0  # distances at which the barriers are compared


def declared(scenario: Scenario) -> list[Check]:
    """Checks of a scenario in addition to those of its configuration."""
    config, target, spec, link = scenario.onboard, scenario.target, scenario.vehicle, scenario.odometry
    touchdown, envelope, told = config.touchdown, config.envelope, config.target
    judge, own = Barrier(scenario.judge.alpha_1_m, scenario.judge.beta_m), config.barrier.build()
    distances = (target.pad_radius_m + k * STEP_M for k in range(int(FAR_M / STEP_M)))
    below_m, at_m = max((judge.height(d) - own.height(d), d) for d in distances)
    feet_m = -load(spec.airframe).geometry.foot_bottom_m
    climb_m_s = math.tau * target.heave_rate_hz * target.heave_amplitude_m
    # key, what the scenario has, its key, room
    accelerates_m_s2 = _acceleration_m_s2(target)
    spread = max(spec.motor_lag_spread, spec.mass_spread + spec.thrust_spread)
    rows = [
        ("barrier", f"{1000.0 * below_m:.3g} mm below at {at_m:.3g} m", "judge", HELD_M - below_m, "m"),
        (
            "touchdown.target_speed_max_m_s",
            f"{touchdown.target_speed_max_m_s:g} for {target.speed_m_s:g}",
            "target.speed_m_s",
            touchdown.target_speed_max_m_s - target.speed_m_s,
            "m/s",
        ),
        (
            "touchdown.pad_radius_m",
            f"{touchdown.pad_radius_m:g} for {target.pad_radius_m:g}",
            "target.pad_radius_m",
            target.pad_radius_m - touchdown.pad_radius_m,
            "m",
        ),
        (
            "touchdown.feet_below_reference_m",
            f"{touchdown.feet_below_reference_m:g} for {feet_m:g}",
            "vehicle.airframe",
            config.contact.gap_m - abs(touchdown.feet_below_reference_m - feet_m),
            "m",
        ),
    ]
    rows.append(
        (
            "envelope.target_acceleration_max_m_s2",
            f"{envelope.target_acceleration_max_m_s2:g} for {accelerates_m_s2:.3g}",
            "target.acceleration_max_m_s2, speed_m_s times turn_rate_rad_s, and heave",
            (1.0 + SPEED_SHARE) * envelope.target_acceleration_max_m_s2 - accelerates_m_s2,
            "m/s^2",
        )
    )
    if config.filter != "paper":  # the paper's filter declares no links
        lag_s, gust_m_s = config.velocity_loop.lag_xy_s, scenario.wind.gust_rms_m_s
        rows += [
            (
                "robust.tracking_error_m_s",
                f"{config.robust.tracking_error_m_s:g} for gusts of {gust_m_s:g}",
                "wind.gust_rms_m_s",
                config.robust.tracking_error_m_s - GUST_SHARE * gust_m_s,
                "m/s",
            ),
            (
                "envelope.lag_spread",
                f"{envelope.lag_spread:g} for {spread:.3g}",
                "vehicle.motor_lag_spread, and mass_spread plus thrust_spread",
                envelope.lag_spread - spread,
                "",
            ),
            (
                "velocity_loop.lag_xy_s",
                f"{RADIO_SHARE * envelope.lag_spread * lag_s:.3g} of it for {spec.setpoint_delay_s:g}",
                "vehicle.setpoint_delay_s",
                RADIO_SHARE * envelope.lag_spread * lag_s - spec.setpoint_delay_s,
                "s",
            ),
            (
                "envelope.target_climb_max_m_s",
                f"{envelope.target_climb_max_m_s:g} for {climb_m_s:.3g}",
                "target.heave_amplitude_m",
                envelope.target_climb_max_m_s - climb_m_s,
                "m/s",
            ),
            (
                "envelope.target_rate_hz",
                f"{envelope.target_rate_hz:g} for {link.rate_hz:g}",
                "odometry.rate_hz",
                link.rate_hz - envelope.target_rate_hz,
                "Hz",
            ),
        ]
        if link.error is None:
            rows += [
                (
                    "target.delay_s",
                    f"{told.delay_s:g} for {link.delay_s:g}",
                    "odometry.delay_s",
                    DELAY_M_S - abs(told.delay_s - link.delay_s),
                    "s",
                ),
                (
                    "target.position_noise_m",
                    f"{told.position_noise_m:g} for {link.position_noise_m:g}",
                    "odometry.position_noise_m",
                    told.position_noise_m - NOISE_SHARE * link.position_noise_m,
                    "m",
                ),
            ]
            rows.append(
                (
                    "target.velocity_noise_m_s",
                    f"{told.velocity_noise_m_s:g} for {link.velocity_noise_m_s:g}",
                    "odometry.velocity_noise_m_s",
                    told.velocity_noise_m_s - NOISE_SHARE * link.velocity_noise_m_s,
                    "m/s",
                )
            )
        if spec.own is None:
            state, mocap = config.own, spec.mocap
            rows += [
                (
                    "own.delay_s",
                    f"{state.delay_s:g} for {mocap.delay_s:g}",
                    "vehicle.mocap.delay_s",
                    DELAY_M_S - abs(state.delay_s - mocap.delay_s),
                    "s",
                ),
                (
                    "own.position_noise_m",
                    f"{state.position_noise_m:g} for {mocap.position_noise_m:g}",
                    "vehicle.mocap.position_noise_m",
                    state.position_noise_m - NOISE_SHARE * mocap.position_noise_m,
                    "m",
                ),
            ]
    return [
        Check(
            f"declared, {key}",
            f"the configuration declares the values of the scenario ({there})",
            room + 1e-12,
            unit,
            f"onboard.{key}: {found}",
            f"make onboard.{key} and {there} agree",
            Need.PROOF,
        )
        for key, found, there, room, unit in rows
    ] + _starts_and_wind(scenario, judge)


def not_proven(team: TeamScenario) -> str:
    """Return one line that names the checks not proven for this scenario; empty if all are proven."""
    found = dict.fromkeys(
        check.name
        for each in team.member
        for check in (*checks(each.onboard), *declared(each))
        if not check.proven
    )
    return f"not proven for this scenario (flightstack check): {', '.join(found)}" if found else ""


def _starts_and_wind(scenario: Scenario, judge: Barrier) -> list[Check]:
    """Checks of what no key of the configuration declares."""
    offset_m, wind_m_s = scenario.start.offset_m, scenario.wind.mean_m_s
    starts_m = scenario.start.h_m[0] if offset_m is None else judge.h(offset_m)
    if scenario.start.kind is not StartKind.HOVER:
        starts_m = math.inf  # on the floor, from where it takes off
    return [
        Check(
            "declared, start",
            "the vehicle starts above the barrier",
            starts_m,
            "m",
            f"start: h is {starts_m:.3g} m",
            "raise start.h_m or start.offset_m: below the barrier it only recovers",
            Need.PROOF,
        ),
        Check(
            "declared, wind.mean_m_s",
            "the mean wind is no stronger than in the tiers, of which the campaigns show that they land",
            WIND_FLOWN_M_S - wind_m_s,
            "m/s",
            f"wind.mean_m_s: {wind_m_s:g}, flown up to {WIND_FLOWN_M_S:g}",
            "lower wind.mean_m_s",
            Need.PROOF,
        ),
    ]


def _acceleration_m_s2(target: TargetSpec) -> float:
    """Largest acceleration of the pad: along the path, across it, and up and down."""
    speed_m_s = min(target.speed_m_s, target.speed_max_m_s)
    turn_rad_s = min(abs(target.turn_rate_rad_s), target.turn_rate_max_rad_s)
    turns_m_s2 = turn_rad_s * (speed_m_s + turn_rad_s * abs(target.pad_behind_axle_m))
    steady = target.path in (PathKind.STRAIGHT, PathKind.CIRCLE) and not target.wait_for_landing
    brakes_m_s2 = 0.0 if steady or speed_m_s == 0.0 else target.acceleration_max_m_s2
    heaves_m_s2 = (math.tau * target.heave_rate_hz) ** 2 * target.heave_amplitude_m
    return max(math.hypot(brakes_m_s2, turns_m_s2), heaves_m_s2)


def crowd(team: TeamScenario) -> list[Check]:
    """Checks of all vehicles of a team together."""
    shapes = [Shape.of(load(each.vehicle.airframe)) for each in team.member]
    radius_m = 2.0 * max(shape.radius_m for shape in shapes)
    up_m = max(shape.top_m for shape in shapes) - min(shape.bottom_m for shape in shapes)
    configs = [each.onboard for each in team.member]
    return team_checks(configs, team.starts_enu_m(), (radius_m, 0.0, up_m), team.pads_apart_m())
