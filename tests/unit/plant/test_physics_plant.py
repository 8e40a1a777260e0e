"""The plant against closed forms, conservation laws, and a second model integrated on its own."""

import math

import numpy as np
import pytest

from sim.plant.params import STEP_S, load
from sim.scenarios.scenario import Wind
from tests import independent_plant as other
from tests.unit.plant.physics_helpers import HIGH_M, FreePlant

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


def test_terminal_velocity_is_weight_over_drag():
    plant = FreePlant()
    plant.run(30_000)
    assert plant.state[5] == pytest.approx(
        -0.0319 * G / 0.0128 * -math.expm1(-30.0 * 0.0128 / 0.0319), rel=1e-5
    )
    assert plant.state[5] == pytest.approx(-24.45, abs=0.01)


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


def test_the_independent_model_would_notice_a_wrong_sign():
    """Each sign of the rotor physics, turned in the reference, is told apart from the simulator."""
    flown, reference = random_flight(0, False, 200.0)
    good = np.abs(flown - reference)[:, 10:13].max(axis=0)
    for name, axis in (("SPIN", 2), ("ROTOR_INERTIA", 2)):
        kept = getattr(other, name)
        try:
            setattr(other, name, -kept)
            _, wrong = random_flight(0, False, 200.0)
        finally:
            setattr(other, name, kept)
        assert np.abs(flown - wrong)[:, 10 + axis].max() > 10.0 * good[axis]


@pytest.mark.parametrize(
    ("slow", "step_rpm", "time_s"), [(False, 300.0, 0.07), (True, 30.0, 0.136), (True, -30.0, 0.108)]
)
def test_motor_lag_as_seen_from_the_thrust(slow, step_rpm, time_s):
    """63 % of a small thrust step after the time constant."""
    plant = FreePlant(slow)
    plant.rotors(HOVER_RPM)
    plant.run(1)
    before = plant.record.rotors.thrust_n
    plant.run(round(time_s * 1000), HOVER_RPM + step_rpm)
    reached = plant.record.rotors.thrust_n - before
    plant.run(3000)
    whole = plant.record.rotors.thrust_n - before
    assert reached / whole == pytest.approx(1.0 - math.exp(-1.0), abs=0.012)


def test_a_spun_up_pair_turns_the_body_the_other_way():
    """All of M1 and M3's new angular momentum is taken from the body; the air's drag adds its share later."""
    plant = FreePlant()
    plant.rotors(HOVER_RPM)
    plant.record.rotors.q1 = plant.record.rotors.q2 = 0.0
    plant.run(1000, (HOVER_RPM + 1000.0, HOVER_RPM, HOVER_RPM + 1000.0, HOVER_RPM))
    gained = 2.0 * 34.5e-9 * 1000.0 * 2.0 * math.pi / 60.0
    assert plant.state[12] == pytest.approx(-gained / 29.8e-6, rel=1e-3)
