"""The plant against closed forms, conservation laws and a second model; its loops against linear ones."""

import math

import numpy as np
import pytest

from sim.firmware.attitude import attitude_moments
from sim.firmware.mixer import mix, motor_speed
from sim.firmware.paper_loop import axes_from_force
from sim.plant.params import STEP_S, load
from sim.plant.rotation import nine
from sim.scenarios.scenario import OdometryLink, VehicleSpec, Wind
from sim.vehicle.loop import push, sense
from sim.world.step import physics_step
from tests import independent_plant as other
from tests import linear_analysis as linear
from tests.unit.vehicle.vehicle_sim_helpers import vehicle

pytestmark = pytest.mark.slow

PROMPT = OdometryLink(100.0)  # motion capture without noise and delay
HIGH_M = 1000.0


def quiet_vehicle(slow=False, **parts):
    """A hovering vehicle without noise, biases and delays."""
    sim = vehicle(vehicle=VehicleSpec(mocap=PROMPT, slow_motors=slow, setpoint_delay_s=0.0), **parts)
    imu = sim._imu.record
    imu.gyro_sigma = imu.accel_sigma = 0.0
    imu.gyro_bias[:] = imu.accel_bias[:] = 0.0
    sim._imu.accel_bias = [0.0, 0.0, 0.0]
    sim._settle()
    return sim


class FreePlant:
    """Body and rotors high above everything, rotor commands prescribed."""

    def __init__(self, slow=False, **parts):
        self.sim = quiet_vehicle(slow, **parts)
        # of the vehicle; drag, rotor maps and so on may be changed before the first step
        self.record = self.sim._vehicle[0]
        self.place()
        self.rotors(0.0)

    def place(self, quaternion=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
        """Put it ``HIGH_M`` above the origin."""
        q = np.array(quaternion) / np.linalg.norm(quaternion)
        self.sim._world.set_vehicle((0.0, 0.0, HIGH_M), tuple(q.tolist()), velocity, rates)

    def rotors(self, rpm):
        """Let them turn at this speed, and go on so."""
        self.record.rotors.rpm[:] = rpm
        self.record.firmware.commands[:] = rpm

    def no_drag(self):
        """Take the rotors' drag on the body away."""
        self.record.drag.xy = self.record.drag.along = 0.0

    def run(self, steps, command=None):
        """Move by so many milliseconds under a command in rpm."""
        if command is not None:
            self.record.firmware.commands[:] = command
        for _ in range(steps):
            push(self.record)
            physics_step(self.record.world)

    @property
    def state(self):
        """Position, velocity, quaternion, rates, rotor speeds: 17 numbers."""
        w = self.sim._world
        return np.array([*w.position, *w.velocity, *w.quaternion, *w.rates, *self.sim._rotors.rpm])


BODY = load().body
G = 9.81
HOVER_RPM = 18968.0  # by hand from the L250 thrust map, 0.0782 N per rotor


def test_free_fall_is_exact():
    plant = FreePlant()
    plant.no_drag()
    for _ in range(4):
        plant.run(500)
        t = plant.sim._world  # z = -g t^2 / 2
        seconds = -t.velocity[2] / G
        assert HIGH_M - t.position[2] == pytest.approx(0.5 * G * seconds**2, rel=1e-9)
    assert plant.state[5] == pytest.approx(-2.0 * G, rel=1e-12)


@pytest.mark.parametrize("seconds", [0.5, 2.0, 5.0])
def test_fall_with_drag_follows_the_closed_form(seconds):
    plant = FreePlant()
    plant.run(round(seconds * 1000))
    rate = 0.0128 / 0.0319  # 1/s, L250 drag along body z over mass
    speed = G / rate * -math.expm1(-rate * seconds)
    fallen = G / rate * seconds - speed / rate
    step_error = 0.5 * STEP_S * rate  # drag is that of the velocity before the step
    assert plant.state[5] == pytest.approx(-speed, rel=1.5 * step_error)
    assert HIGH_M - plant.state[2] == pytest.approx(fallen, rel=1.5 * step_error)


def test_falls_sideways_with_the_wind_in_the_end():
    plant = FreePlant(wind=Wind(2.0, direction_rad=0.5))
    plant.place()
    plant.run(20_000)
    share = -math.expm1(-20.0 * 0.0147 / 0.0319)
    assert plant.state[3:5] == pytest.approx(share * 2.0 * np.array([math.cos(0.5), math.sin(0.5)]), rel=1e-3)


def test_hover_is_where_the_data_sheet_puts_it():
    plant = FreePlant()
    plant.no_drag()
    plant.rotors(HOVER_RPM)
    plant.run(1)
    thrust = plant.record.rotors.thrust_n
    assert thrust == pytest.approx(4 * 0.0782, rel=1e-3)
    assert 4 * 0.12 / thrust == pytest.approx(1.53, abs=0.01)  # thrust to weight
    assert thrust / 4 / 0.12 * 65535 == pytest.approx(42_700, abs=50)  # counts
    plant.run(999)
    assert abs(plant.state[5]) < 0.005  # 18968 rpm is rounded


def test_energy_of_a_free_flight_is_conserved():
    plant = FreePlant()
    plant.no_drag()
    plant.place((0.9, 0.3, -0.2, 0.1), velocity=(2.0, -1.0, 5.0), rates=(6.0, -4.0, 9.0))

    def energies():
        s = plant.state
        turning = 0.5 * float(np.array(BODY.inertia_kg_m2) @ s[10:13] ** 2)
        return 0.5 * BODY.mass_kg * float(s[3:6] @ s[3:6]) + BODY.mass_kg * G * (s[2] - HIGH_M), turning

    moving, turning = energies()
    for _ in range(5):
        plant.run(1000)
        assert energies()[0] == pytest.approx(moving, rel=1e-6)
        assert energies()[1] == pytest.approx(turning, rel=1e-6)


def angular_momentum(plant):
    """Of body and rotors, world frame, N m s."""
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
    # of first order in the step: the gyroscopic torque is that of the rates before it
    worst = np.abs(angular_momentum(plant) - before).max()
    assert worst < 2e-3 * np.linalg.norm(before)
    assert np.abs(plant.state[10:13] - (1.0, -0.7, 2.0)).max() > 1.0  # while the body changed its rates


def random_flight(seed, slow, spread_rpm):
    """Simulated and independent states under random rotor commands, 1.5 s."""
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
@pytest.mark.parametrize("seed", range(4))
def test_six_degrees_of_freedom_agree_with_the_independent_model(seed, slow):
    """Rates, attitude, velocity, position and speeds over 1.5 s of random commands.

    The simulator takes a step's torque at its end and the thrust's direction at its begin: an error of half a
    step times how fast these change. The tolerances are once or twice that, none of them fitted.
    """
    flown, reference = random_flight(seed, slow, 200.0)
    error = np.abs(flown - reference)
    rates = reference[:, 10:13]
    turning = np.abs(rates).max()
    angular_acceleration = np.abs(np.diff(rates, axis=0)).max(axis=0) / 0.02
    assert turning > 0.5  # it has turned
    assert (error[:, 10:13].max(axis=0) < STEP_S * angular_acceleration + 1e-4).all()
    assert 2.0 * error[:, 6:10].max() < STEP_S * turning + 1e-4  # rad
    assert error[:, 3:6].max() < 0.5 * STEP_S * turning * G * 1.5  # thrust, about m g, turned by half a step
    assert error[:, :3].max() < 0.5 * STEP_S * turning * G * 1.5**2 / 2.0
    assert error[:, 13:].max() < (0.01 if slow else 1e-6)  # rpm; the slow fall is a second-order step


NOMINAL_S = 0.07
HOVER_COUNTS = linear.MASS * linear.G / 4.0 / linear.N_PER_COUNT
STEP_DEG = 1.0


def lag_of(slow):
    return linear.slow_lag_s() if slow else NOMINAL_S


def attitude_step(axis, slow, seconds):
    """Roll, pitch or yaw after a step of the desired attitude in hover, in parts of the step, 500 Hz."""
    plant = FreePlant(slow)
    plant.no_drag()
    plant.rotors(linear.HOVER_RPM)
    plant.sim._settle()
    f, size = plant.record.firmware, math.radians(STEP_DEG)
    force = [(0.0, -math.tan(size), 1.0), (math.tan(size), 0.0, 1.0), (0.0, 0.0, 1.0)][axis]
    yaw = size if axis == 2 else 0.0
    desired = axes_from_force(*force, math.cos(yaw), math.sin(yaw))
    f.paper.attitude.wx = math.nan
    out = []
    for k in range(round(seconds * 500)):
        if k % 100 == 0:
            plant.sim._imu.top_up()
        sense(plant.sim._vehicle)
        s = f.estimator.sensed
        moments = attitude_moments(
            f.paper.attitude, nine(s.axes), desired, s.rates[0], s.rates[1], s.rates[2]
        )
        counts = mix(HOVER_COUNTS, moments)
        plant.run(2, [motor_speed(f.thrust_map, c, 1e9) for c in counts])
        w, x, y, z = plant.state[6:10]
        angle = (2.0 * w * x, 2.0 * w * y, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
        out.append(angle[axis] / size)
    return np.array(out)


def slowest(poles, count):
    """The poles that last, without integrators that the output does not show."""
    return np.array([p for p in poles if p.real < -0.3][:count])


def nearest(pole, candidates):
    return min(np.abs(np.asarray(candidates) - pole))


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
def test_roll_and_pitch_steps_have_the_linear_models_poles(axis, slow):
    y = attitude_step(axis, slow, 1.5)
    assert y[-1] == pytest.approx(1.0, abs=0.01)
    loop = linear.roll_loop(lag_of(slow))
    assert np.abs(y - loop.response(1.5)).max() < 0.01
    measured = linear.prony_poles(y, linear.DT, 3)
    for pole in slowest(loop.poles(), 3):
        assert nearest(pole, measured) < 0.1 * abs(pole)


@pytest.mark.parametrize("slow", [False, True])
def test_yaw_step_has_the_linear_models_poles(slow):
    y = attitude_step(2, slow, 5.0)
    loop = linear.yaw_loop(lag_of(slow))
    expected = loop.response(5.0)
    assert np.abs(y - expected).max() < 0.015
    measured = linear.prony_poles(y, linear.DT, 4)  # the integral's slow pole and the motor's among them
    for pole in slowest(loop.poles(), 2):
        assert nearest(pole, measured) < 0.1 * abs(pole)
    without = linear.yaw_loop(lag_of(slow), reaction=False).response(5.0)
    assert np.abs(y - without).max() > 3.0 * np.abs(y - expected).max()  # the reaction torque shows


def velocity_step(axis, slow, seconds):
    """Velocity along an axis after a small step of the set-point, in parts of the step, 500 Hz."""
    sim = quiet_vehicle(slow)
    size = 0.02
    sim.set_velocity((0.0, 0.0, 0.0), 0.0)
    sim.advance(500)
    before = np.array(sim.truth().velocity_enu_m_s)
    wanted = [0.0, 0.0, 0.0]
    wanted[axis] = size
    out = []
    for k in range(round(seconds * 500)):
        if k % 50 == 0:
            sim.set_velocity(tuple(wanted), 0.0)
        sim.advance(2)
        out.append((sim.truth().velocity_enu_m_s[axis] - before[axis]) / size)
    return np.array(out)


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_velocity_steps_of_the_papers_loop(axis, slow):
    """Whole vehicle, K_v = 0.5: estimator, attitude loop, motors and all."""
    y = velocity_step(axis, slow, 3.0)
    if axis == 2:  # thrust of all four rises together, with the rate of rising
        lag = 1.0 / linear.PARAMS.rotor.slow_rise_1_s if slow else NOMINAL_S
        loop = linear.vertical_loop(lag)
    else:
        loop = linear.horizontal_loop(lag_of(slow))
    expected = loop.response(3.0)
    asymmetric = slow and axis == 2  # the linear model rises only, the slow motors also fall, faster
    assert np.abs(y - expected).max() < (0.12 if asymmetric else 0.015)
    assert y.max() == pytest.approx(expected.max(), rel=0.1)  # the overshoot
    assert y.argmax() == pytest.approx(expected.argmax(), rel=0.1)
