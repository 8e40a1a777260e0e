"""The simulated vehicle without its firmware: rotor speeds in, true state out, in steps of 1 ms.

The same world, rotors, battery, wind, ground effect and deck as ``VehicleSim``, with the functions of its
loop; only what the firmware does there is left to another autopilot. Deterministic in (scenario, seed,
commands).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier import Barrier
from flightstack.strict_toml import ConfigError
from flightstack.types import Vec3
from sim.battery import BatteryModel, drain, speed_limit
from sim.contact import GAP_MS, NONE_MS, note_contact
from sim.flight import (
    BATTERY_EVERY_MS,
    CONTROL_EVERY_MS,
    WIND_EVERY_MS,
    VehicleRecord,
    cushion,
    judge,
    move,
)
from sim.ground_effect import GroundEffect
from sim.jit import jitted
from sim.params import STEP_S, Params, Plant, load
from sim.records import F64, Cell, cell, new, reader, scalars
from sim.rotors import Four, Rotors
from sim.scenario import Scenario, StartKind
from sim.target import TargetModel
from sim.vehicle import AIRBORNE_AFTER_MS, CONTACT_TUMBLED, NAN3
from sim.vehicle_types import Truth
from sim.wind import WindModel, blow
from sim.world import World, contact_count, touched

SUPPLY_MS = 1000  # the wind takes a number every 5 ms and is given at least 340 of them


class Body(NamedTuple):
    """True state of the vehicle's centre of mass."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # w, x, y, z; FLU body in ENU world
    angular_velocity_flu_rad_s: Vec3


@jitted
def fly_commanded(vehicle: Cell[VehicleRecord], wanted: F64, now_ms: int, end_ms: int) -> int:
    """Run steps of 1 ms with these rotor speeds wanted (rpm, M1..M4); the battery limits them.

    Returns:
        Time reached, ms.
    """
    v = vehicle[0]
    while now_ms < end_ms:
        if now_ms % CONTROL_EVERY_MS == 0:
            limit = speed_limit(v.battery)
            for i in range(4):
                v.firmware.commands[i] = min(wanted[i], limit)
            cushion(v)
        if now_ms % WIND_EVERY_MS == 0:
            blow(v.wind)
        if now_ms % BATTERY_EVERY_MS == 0:
            drain(v.battery, v.rotors.rpm, BATTERY_EVERY_MS * STEP_S)
        move(v)
        judge(v)
        if contact_count(v.memory) > 0:
            note_contact(v.contact, v.deck, touched(v.memory), now_ms, v.before_e, v.before_velocity)
        now_ms += 1
    return now_ms


def start_position(scenario: Scenario, params: Params, pad_enu_m: Vec3) -> Vec3:
    """Where the vehicle stands: at its start on the ground, or on the floor below a given hover start.

    Raises:
        ConfigError: the start is drawn by chance, which may be inside the robot.
    """
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
    """One vehicle, standing on the floor, and its deck.

    Attributes:
        params: of the vehicle's file.
        plant: factors by which this vehicle differs from the nominal one.
        wanted: rotor speeds to aim at, rpm, M1..M4; set it before ``advance``.

    Args:
        scenario: plant, wind, target, start, judge.
        seed: of the run.

    Raises:
        ConfigError: faults, which need the simulated firmware, or a start that cannot be had.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        if scenario.fault:
            raise ConfigError(
                f"scenario {scenario.name!r}: found {len(scenario.fault)} [[fault]], allowed are none: "
                "faults act in the simulated firmware and links; take a scenario without them"
            )
        self.params = params = load(scenario.vehicle.airframe)
        self.plant = plant = Plant.draw(scenario.vehicle, seed)
        mass, gravity = params.body.mass_kg * plant.mass, params.contact.gravity_m_s2
        judged = scenario.judge
        self._barrier = Barrier(judged.alpha_1_m, judged.beta_m)
        r = new(VehicleRecord)
        self._vehicle = cell(r)
        self._world = World(params, mass, scenario.target, r.body, r.deck, r.reach, r.memory)
        self._rotors = Rotors(params.rotor, plant, scenario.vehicle.slow_motors, STEP_S, r.rotors)
        pad_radius = scenario.target.pad_radius_m
        GroundEffect(params.rotor, scenario.vehicle.ground_effect_gain, pad_radius, r.ground)
        hover_rpm = params.rotor.rpm(mass * gravity / 4.0 / plant.thrust)
        self._battery = BatteryModel(params.battery, hover_rpm, r.battery)
        self._wind = WindModel(scenario.wind, params.wind, seed, WIND_EVERY_MS * STEP_S, r.wind)
        drag_xy, _, drag_z = params.body.drag_n_s_m
        r.drag.xy, r.drag.along, r.drag.weight = drag_xy, drag_z - drag_xy, mass * gravity
        cell(r.judge)[0] = (judged.alpha_1_m, judged.beta_m, pad_radius, math.inf, math.inf, False)
        r.motor_share[:] = 1.0
        self._h_min, self._h_min_outside, self._tumbled = scalars(
            r.judge, "h_min", "h_min_outside", "tumbled"
        )
        self._pad_ms, self._ground_ms, since_ms = scalars(r.contact, "pad_ms", "ground_ms", "since_ms")
        self._touch_ms, self._judging, self._contacts = scalars(r.contact, "touch_ms", "judging", "bits")
        self._pad_ms[0] = self._touch_ms[0] = NONE_MS
        self._ground_ms[0] = since_ms[0] = 0
        self._read_body, self._read_deck = reader(r.body), reader(r.deck)
        self._read_contact = reader(r.contact)
        self.wanted = np.zeros(4)
        self._ms = self._supplied_ms = 0
        target = TargetModel(scenario.target, seed)
        pose = target.pose
        self.set_deck(pose.position_enu_m, pose.yaw_rad, target.velocity_enu_m_s, target.yaw_rate_rad_s)
        self._world.set_vehicle(start_position(scenario, params, pose.position_enu_m))

    def set_deck(
        self, position_enu_m: Vec3, yaw_rad: float, velocity_enu_m_s: Vec3, yaw_rate_rad_s: float
    ) -> None:
        """True pose and twist of the pad centre now; it moves on an arc until the next call."""
        self._world.set_deck(position_enu_m, yaw_rad, velocity_enu_m_s, yaw_rate_rad_s)

    def advance(self, steps: int) -> None:
        """Run ``steps`` physics steps of 1 ms."""
        end_ms = self._ms + steps
        while self._ms < end_ms:
            if self._ms >= self._supplied_ms:
                self._wind.top_up()
                self._supplied_ms = self._ms + SUPPLY_MS
            stop_ms = min(end_ms, self._supplied_ms)
            self._ms = fly_commanded(self._vehicle, self.wanted, self._ms, stop_ms)
        if not self._judging[0] and self._ms - max(self._pad_ms[0], self._ground_ms[0]) > AIRBORNE_AFTER_MS:
            self._judging[0] = True

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._ms * STEP_S

    @property
    def on_pad(self) -> bool:
        """In contact with the pad's top (bounces shorter than 30 ms don't count)."""
        return bool(self._ms - self._pad_ms[0] <= GAP_MS)

    @property
    def on_ground(self) -> bool:
        """In contact with the floor."""
        return bool(self._ms - self._ground_ms[0] <= GAP_MS)

    @property
    def rotor_rpm(self) -> Four:
        """Speeds of M1..M4."""
        return self._rotors.rpm

    def body(self) -> Body:
        """Return the true state now."""
        b = self._read_body()  # in the order of its record
        return Body(b[:3], b[3:6], b[6:10], b[10:13])

    def truth(self) -> Truth:
        """Return the true state now and the extremes and contacts since the last call; those start anew."""
        body, deck = self._read_body(), self._read_deck()
        position, pad = body[:3], deck[:3]
        h = self._barrier.h((position[0] - pad[0], position[1] - pad[1], position[2] - pad[2]))
        touch_s, touch_e, touch_v = math.nan, NAN3, NAN3
        if self._touch_ms[0] != NONE_MS:
            contact = self._read_contact()  # ends with place and velocity
            touch_s, touch_e, touch_v = self._touch_ms[0] * STEP_S, contact[-6:-3], contact[-3:]
        truth = Truth(
            self.time_s, position, body[3:6], body[6:10], body[10:13], self._rotors.rpm,
            pad, deck[3:6], math.remainder(deck[6], 2.0 * math.pi),
            h, min(h, self._h_min[0]), self._h_min_outside[0],
            self._contacts[0] | (CONTACT_TUMBLED if self._tumbled[0] else 0),
            touch_e, touch_v, touch_s, bool(self.wanted.any()), self._battery.voltage_v,
            self._wind.now_enu_m_s,
        )  # fmt: skip
        self._h_min[0] = self._h_min_outside[0] = math.inf
        self._tumbled[0] = self._contacts[0] = 0
        return truth
