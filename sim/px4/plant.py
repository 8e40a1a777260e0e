"""The simulated vehicle without firmware: computes the true state from rotor speeds in steps of 1 ms.

World, rotors, battery, wind, ground effect and deck use the functions of ``VehicleSim``; PX4 replaces the
firmware. The result depends only on scenario, seed and commands.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.common.strict_toml import ConfigError
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell
from flightstack.core.types import Vec3
from sim.plant.params import Params
from sim.plant.rotors import speed_limit
from sim.plant.states import Truth
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import StartKind
from sim.vehicle.physics import (
    CONTROL_EVERY_MS,
    Physics,
    VehicleRecord,
    apply_ground_effect,
    move,
    push,
    surround,
)

SUPPLY_MS = 1000  # time for which random numbers are drawn in advance: at least 340, one is used every 5 ms


class Body(NamedTuple):
    """True state of the vehicle; the position is the position of the centre of mass."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # attitude (w, x, y, z) of body FLU in world ENU
    angular_velocity_flu_rad_s: Vec3


@jitted
def fly_commanded(vehicle: Cell[VehicleRecord], wanted: F64, begin_ms: int, end_ms: int) -> None:
    """Run steps of 1 ms with these commanded rotor speeds (rpm, M1..M4); the battery limits them."""
    v = vehicle[0]
    for now_ms in range(begin_ms, end_ms):
        if now_ms % CONTROL_EVERY_MS == 0:
            limit = speed_limit(v.battery)
            for i in range(4):
                v.firmware.commands[i] = min(wanted[i], limit)
            apply_ground_effect(v)
        surround(v, now_ms)
        push(v)
        move(v, now_ms)


def start_position(scenario: Scenario, params: Params, pad_enu_m: Vec3) -> Vec3:
    """Return the start position on the floor: the scenario's ground start, or the point below its hover."""
    z = -params.geometry.foot_bottom_m - 1e-5
    if scenario.start.kind is StartKind.GROUND:
        return (*scenario.start.ground_position_m, z)
    if scenario.start.offset_m is None:
        raise ConfigError(
            f"scenario {scenario.name!r}: found start.kind = 'hover' without start.offset_m; PX4 begins on "
            "the floor, so the place must be given: start.kind = 'ground', or start.offset_m"
        )
    return (pad_enu_m[0] + scenario.start.offset_m[0], pad_enu_m[1] + scenario.start.offset_m[1], z)


class Px4Plant:
    """One vehicle at rest on the floor, and its deck; set ``wanted`` before ``advance``."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        if scenario.fault:
            raise ConfigError(
                f"scenario {scenario.name!r}: found {len(scenario.fault)} [[fault]], allowed are none: "
                "faults act in the simulated firmware and links; take a scenario without them"
            )
        self._physics = physics = Physics(scenario, seed)
        self.params, self.plant, self._world = physics.params, physics.plant, physics.world
        self._vehicle = physics.vehicle
        physics.record.motor_share[:] = 1.0
        physics.ground_ms[0] = physics.since_ms[0] = 0
        self.wanted = np.zeros(4)  # commanded rotor speeds of M1..M4, rpm
        self._ms = self._supplied_ms = 0
        self._world.set_vehicle(start_position(scenario, self.params, self._world.deck_position))

    def set_deck(
        self, position_enu_m: Vec3, yaw_rad: float, velocity_enu_m_s: Vec3, yaw_rate_rad_s: float
    ) -> None:
        """Set the true pose and velocity of the pad centre; it moves on an arc until the next call."""
        self._world.set_deck(position_enu_m, yaw_rad, velocity_enu_m_s, yaw_rate_rad_s)

    def advance(self, steps: int) -> None:
        """Run ``steps`` physics steps of 1 ms."""
        end_ms = self._ms + steps
        while self._ms < end_ms:
            if self._ms >= self._supplied_ms:
                self._physics.top_up()
                self._supplied_ms = self._ms + SUPPLY_MS
            stop_ms = min(end_ms, self._supplied_ms)
            fly_commanded(self._vehicle, self.wanted, self._ms, stop_ms)
            self._ms = stop_ms
        self._physics.judge_once_airborne(self._ms)

    def body(self) -> Body:
        b = self._physics.body()
        return Body(b[:3], b[3:6], b[6:10], b[10:13])

    def truth(self) -> Truth:
        """Return the current true state, and extremes and contacts since the last call; reset the latter."""
        return self._physics.truth(self._ms)
