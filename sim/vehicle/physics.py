"""Physics of one vehicle without its autopilot: world, rotors, battery, wind, deck, and the true state."""

from __future__ import annotations

import math

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell, Values, cell, new, reader, scalars
from flightstack.core.numeric import numeric, twin, wrapped
from flightstack.core.safety.barrier import barrier_h
from logs.schema.events import ContactBit
from sim.firmware.stack import running
from sim.plant.air import CorrelatedNoise, WindModel, set_up_downwash
from sim.plant.params import STEP_S, Params, Plant, able_to_hover, load
from sim.plant.rotors import BatteryModel, Rotors, set_up_ground
from sim.plant.states import TRUTH, Truth, truth_of
from sim.robot.target import TargetModel
from sim.scenarios.scenario import Scenario
from sim.vehicle.judge import GAP_MS, NONE_MS
from sim.vehicle.loop import WIND_EVERY_MS, VehicleRecord, set_up_drag
from sim.world.world import World

AIRBORNE_AFTER_MS = 200  # time without contact after which the vehicle counts as airborne
TUMBLED = ContactBit.TUMBLED.value
_VEHICLE = ContactBit.VEHICLE.value


@numeric
def _turned_back(angle_rad: float) -> float:
    return wrapped(angle_rad)


_wrapped, _h = twin(_turned_back, jitted), twin(barrier_h, jitted)


@jitted
def write_truth(v: VehicleRecord, now_ms: int, row: F64) -> None:
    """Write the true state, and the extremes and contacts since the last call, to the ``TRUTH`` elements."""
    body, deck, j, c = v.world.body, v.world.deck, v.judge, v.contact
    p, d = body.position, deck.position
    h = _h(j.alpha_1_m, j.beta_m, (p[0] - d[0], p[1] - d[1], p[2] - d[2]))
    row[0] = now_ms * STEP_S
    for i in range(3):
        row[1 + i], row[4 + i], row[11 + i] = p[i], body.velocity[i], body.rates[i]
        row[18 + i], row[21 + i], row[38 + i] = d[i], deck.velocity[i], v.wind.now[i]
    for i in range(4):
        row[7 + i], row[14 + i] = body.quaternion[i], v.rotors.rpm[i]
    row[24], row[25], row[26], row[27] = (
        _wrapped(deck.yaw),
        h,
        j.h_min if j.h_min < h else h,
        j.h_min_outside,
    )
    row[28] = c.bits | (TUMBLED if j.tumbled else 0)
    touched = c.touch_ms != NONE_MS
    for i in range(3):
        row[29 + i] = c.touch_e[i] if touched else math.nan
        row[32 + i] = c.touch_velocity[i] if touched else math.nan
    row[35] = c.touch_ms * STEP_S if touched else math.nan
    row[36], row[37] = 1.0 if running(v.firmware.commands) else 0.0, v.battery.voltage_v
    j.h_min = j.h_min_outside = math.inf
    j.tumbled = False
    c.bits = 0


@jitted
def read_truth(vehicle: Cell[VehicleRecord], now_ms: int, row: F64) -> None:
    """Call ``write_truth``."""
    write_truth(vehicle[0], now_ms, row)


class Physics:
    """Body and surroundings of one vehicle; times are simulated times in ms.

    ``params``: replaces the vehicle file's parameters; ``plant``: replaces the plant drawn from the seed.
    """

    def __init__(
        self, scenario: Scenario, seed: int, params: Params | None = None, plant: Plant | None = None
    ) -> None:
        self.params = params = params or load(scenario.vehicle.airframe)
        if plant is None:
            plant, reserve = Plant.draw(scenario.vehicle, seed), scenario.vehicle.hover_reserve
            plant = able_to_hover(plant, params, reserve) if reserve > 0.0 else plant
        self.plant = plant  # ratios of this vehicle's true parameters to the nominal parameters
        mass_kg = params.body.mass_kg * plant.mass
        self.weight_n = mass_kg * params.contact.gravity_m_s2
        # record: state of the 1 ms steps, one contiguous array; vehicle: the same array for compiled code
        self.record = r = new(VehicleRecord)
        self.vehicle = cell(r)
        # each of these objects stores its state in its part of ``record``
        self.world = World(params, mass_kg, scenario.target, r.world)
        self.rotors = Rotors(params.rotor, plant, scenario.vehicle.slow_motors, STEP_S, r.rotors)
        pad_radius = scenario.target.pad_radius_m
        set_up_ground(r.ground, params.rotor, scenario.vehicle.ground_effect_gain, pad_radius)
        # rotor speed in hover without wind, rpm
        self.hover_rpm = params.rotor.rpm(self.weight_n / 4.0 / plant.thrust)
        self.battery = BatteryModel(params.battery, self.hover_rpm, r.battery, plant.battery_charge)
        self.wind = WindModel(scenario.wind, params.wind, seed, WIND_EVERY_MS * STEP_S, r.wind)
        shape, step_s = params.torque_noise, WIND_EVERY_MS * STEP_S
        self._torque_noise = CorrelatedNoise(
            shape.rms_n_m, shape.time_s, seed, "torque.noise", step_s, r.torque_noise
        )
        set_up_drag(r.drag, params.body, self.weight_n)
        set_up_downwash(r.downwash, params.body, params.rotor, params.geometry)
        self.barrier = judge = scenario.judged_by
        cell(r.judge)[0] = (judge.alpha_1_m, judge.beta_m, pad_radius, math.inf, math.inf, False)
        # arrays with one element: start of the current contact, last contact with pad and with floor
        self.since_ms, self.pad_ms, self.ground_ms = scalars(r.contact, "since_ms", "pad_ms", "ground_ms")
        # arrays with one element: first touch, whether touches count, contact bits
        self._touch_ms, self.judging, self._contacts = scalars(r.contact, "touch_ms", "judging", "bits")
        for times in (self.since_ms, self.pad_ms, self.ground_ms, self._touch_ms):
            times[0] = NONE_MS
        self._read_body, self._row = reader(r.world.body), np.empty(TRUTH)
        self._read_row = reader(self._row)
        target = TargetModel(scenario.target, seed)
        pose = target.pose
        self.world.set_deck(pose.position_enu_m, pose.yaw_rad, target.velocity_enu_m_s, target.yaw_rate_rad_s)

    def top_up(self) -> None:
        """Draw the random numbers of wind and torque noise for at least 340 steps of each."""
        self.wind.top_up()
        self._torque_noise.top_up()

    def on_pad(self, now_ms: int) -> bool:
        """Return whether the vehicle touches the pad's top; a gap below 30 ms does not end the contact."""
        return bool(now_ms - self.pad_ms[0] <= GAP_MS)

    def on_ground(self, now_ms: int) -> bool:
        """Return whether the vehicle touches the floor."""
        return bool(now_ms - self.ground_ms[0] <= GAP_MS)

    def judge_from_here(self) -> None:
        """Start the judged part of the flight and clear earlier contacts."""
        self.judging[0] = True
        self._touch_ms[0] = NONE_MS

    def airborne(self, now_ms: int) -> bool:
        """Return whether the vehicle has been without contact for ``AIRBORNE_AFTER_MS``."""
        return bool(now_ms - max(self.pad_ms[0], self.ground_ms[0]) > AIRBORNE_AFTER_MS)

    def judge_once_airborne(self, now_ms: int) -> None:
        """Start the judged part of the flight once the vehicle has taken off."""
        if not self.judging[0] and self.airborne(now_ms):
            self.judging[0] = True

    def collide(self) -> None:
        """Record a collision with another vehicle."""
        self._contacts[0] |= _VEHICLE

    def body(self) -> Values:
        """Position (3), velocity (3), quaternion (4, w first) and angular velocity (3), in record order."""
        return self._read_body()

    def truth(self, now_ms: int) -> Truth:
        """Return the current true state, and extremes and contacts since the last call."""
        read_truth(self.vehicle, now_ms, self._row)
        found = truth_of(self._read_row())
        return found._replace(contacts=int(found.contacts), motors_running=found.motors_running != 0.0)
