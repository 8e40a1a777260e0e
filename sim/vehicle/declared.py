"""Checks that a configuration declares the robot, the pad, the links and the barrier of its scenario.

The certificate proves a configuration for what it declares. These checks compare its declarations with the
scenario, so that a proof applies to the flight.
"""

from __future__ import annotations

import math

from flightstack.core.safety.barrier import Barrier
from flightstack.verify.robust import HELD_M
from flightstack.verify.team import team_checks
from flightstack.verify.types import Check, Need
from sim.plant.params import load
from sim.scenarios.scenario import Scenario
from sim.scenarios.team import TeamScenario
from sim.vehicle.encounters import Shape

DELAY_M_S = 0.02  # s; allowed difference of a declared delay, within the errors of the noise
NOISE_SHARE = 0.5  # least declared share of a link's noise, which an estimator filters
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
    if config.filter != "paper":  # the paper's filter declares no links
        rows += [
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
            rows.append(
                (
                    "own.delay_s",
                    f"{config.own.delay_s:g} for {spec.mocap.delay_s:g}",
                    "vehicle.mocap.delay_s",
                    DELAY_M_S - abs(config.own.delay_s - spec.mocap.delay_s),
                    "s",
                )
            )
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
    ]


def crowd(team: TeamScenario) -> list[Check]:
    """Checks of all vehicles of a team together."""
    shapes = [Shape.of(load(each.vehicle.airframe)) for each in team.member]
    radius_m = 2.0 * max(shape.radius_m for shape in shapes)
    up_m = max(shape.top_m for shape in shapes) - min(shape.bottom_m for shape in shapes)
    configs = [each.onboard for each in team.member]
    return team_checks(configs, team.starts_enu_m(), (radius_m, 0.0, up_m), team.pads_apart_m())
