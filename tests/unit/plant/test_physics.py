"""Compares the simulated vehicle with a second model, a conservation law and a closed form."""

import numpy as np
import pytest

from sim.plant.params import STEP_S, load
from sim.scenarios.tables import OdometryLink, VehicleSpec
from sim.vehicle.physics import push
from sim.world.step import physics_step
from tests import independent_plant as other
from tests.unit.vehicle.vehicle_sim_helpers import vehicle

pytestmark = pytest.mark.slow

PROMPT = OdometryLink(100.0)  # motion capture without noise and delay
HIGH_M = 1000.0


def quiet_vehicle(slow=False, **parts):
    """Return a hovering vehicle without noise, biases and delays."""
    sim = vehicle(vehicle=VehicleSpec(mocap=PROMPT, slow_motors=slow, setpoint_delay_s=0.0), **parts)
    imu = sim._imu.record
    imu.gyro_sigma = imu.accel_sigma = 0.0
    imu.gyro_bias[:] = imu.accel_bias[:] = 0.0
    sim._imu.accel_bias = [0.0, 0.0, 0.0]
    sim._settle()
    return sim


class FreePlant:
    """Simulated body and rotors in free air, with given rotor commands."""

    def __init__(self, slow=False, **parts):
        self.sim = quiet_vehicle(slow, **parts)
        # parameters of the vehicle; drag, rotor maps etc. may be changed before the first step
        self.record = self.sim.cell[0]
        self.place()
        self.rotors(0.0)

    def place(self, quaternion=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
        """Move the vehicle ``HIGH_M`` above the origin."""
        q = np.array(quaternion) / np.linalg.norm(quaternion)
        self.sim._world.set_vehicle((0.0, 0.0, HIGH_M), tuple(q.tolist()), velocity, rates)

    def rotors(self, rpm):
        """Set speed and command of the rotors, rpm."""
        self.record.rotors.rpm[:] = rpm
        self.record.firmware.commands[:] = rpm

    def run(self, steps, command=None):
        """Advance by this number of milliseconds with a command in rpm; None: the previous command."""
        if command is not None:
            self.record.firmware.commands[:] = command
        for _ in range(steps):
            push(self.record)
            physics_step(self.record.world)

    @property
    def state(self):
        """Position, velocity, quaternion, body rates and rotor speeds: 17 values."""
        return np.array([*np.concatenate(self.sim.body()), *self.record.rotors.rpm])


BODY = load().body
G = 9.81
HOVER_RPM = 18968.0  # computed by hand from the L250 thrust map, 0.0782 N per rotor


def angular_momentum(plant):
    """Return the angular momentum of body and rotors, world frame, N m s."""
    s = plant.state
    rotors = np.array([0.0, 0.0, other.ROTOR_INERTIA * other.RAD_S * (other.SPIN @ s[13:])])
    return other.rotation(s[6:10]) @ (np.array(BODY.inertia_kg_m2) * s[10:13] + rotors)


def test_angular_momentum_with_the_rotors_is_conserved_without_air():
    plant = FreePlant()
    r = plant.record.rotors
    r.p1 = r.p2 = r.q1 = r.q2 = 0.0
    plant.place((0.9, 0.3, -0.2, 0.1), rates=(1.0, -0.7, 2.0))
    plant.rotors(HOVER_RPM)
    before = angular_momentum(plant)
    rng = np.random.default_rng(4)
    for _ in range(20):
        plant.run(50, rng.uniform(0.0, 24_000.0, 4))
    # the error is of first order in the time step: the gyroscopic torque uses the rates before the step
    worst = np.abs(angular_momentum(plant) - before).max()
    assert worst < 2e-3 * np.linalg.norm(before)
    assert np.abs(plant.state[10:13] - (1.0, -0.7, 2.0)).max() > 1.0  # the body's rates changed


def random_flight(seed, slow, spread_rpm):
    """Return states of the simulator and of the independent model during 1.5 s of random rotor commands."""
    rng = np.random.default_rng(seed)
    plant = FreePlant(slow)
    q = np.array([0.98, *rng.uniform(-0.15, 0.15, 3)])
    plant.place(q, tuple(rng.uniform(-1.0, 1.0, 3).tolist()), tuple(rng.uniform(-1.0, 1.0, 3).tolist()))
    plant.rotors(HOVER_RPM)
    start = plant.state
    commands = HOVER_RPM + spread_rpm * rng.standard_normal((75, 4))
    reference = other.fly(start, commands, 0.02, other.SLOW if slow else None)
    flown = []
    for command in commands:
        plant.run(20, command)
        flown.append(plant.state)
    return np.array(flown), reference


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_six_degrees_of_freedom_agree_with_the_independent_model(seed, slow):
    """Compare rates, attitude, velocity, position and rotor speeds over 1.5 s of random commands.

    In each step, the simulator applies the torque of the step's end and the thrust direction of its start.
    The error is half a step times the rates of change of both; the tolerance is one or two times this error.
    """
    flown, reference = random_flight(seed, slow, 200.0)
    error = np.abs(flown - reference)
    rates = reference[:, 10:13]
    turning = np.abs(rates).max()
    angular_acceleration = np.abs(np.diff(rates, axis=0)).max(axis=0) / 0.02
    assert turning > 0.5  # the vehicle turns enough for a test of the bounds
    assert (error[:, 10:13].max(axis=0) < STEP_S * angular_acceleration + 1e-4).all()
    assert 2.0 * error[:, 6:10].max() < STEP_S * turning + 1e-4  # error of the angle, rad
    assert error[:, 3:6].max() < 0.5 * STEP_S * turning * G * 1.5  # thrust, about m g, turned by half a step
    assert error[:, :3].max() < 0.5 * STEP_S * turning * G * 1.5**2 / 2.0
    assert error[:, 13:].max() < (0.01 if slow else 1e-6)  # rpm; the slow lag is integrated to second order
