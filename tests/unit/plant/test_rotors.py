"""Rotor wrench: maps, lag, signs, ground effect, battery."""

import itertools
import math

import pytest

from sim.plant.ground_effect import GroundEffect
from sim.plant.params import STEP_S, Plant, load
from sim.plant.rotors import MIX_YAW, POSITION_X, POSITION_Y, RAD_S_PER_RPM, Rotors
from sim.plant.vehicle_types import BatteryModel

PARAMS = load()
ROTOR = PARAMS.rotor
WEIGHT_N = PARAMS.body.mass_kg * PARAMS.contact.gravity_m_s2
HOVER = ROTOR.rpm(WEIGHT_N / 4.0)


def rotors(slow=False, **factors):
    return Rotors(ROTOR, Plant(**factors), slow, STEP_S)


def settled(command, **factors):
    r = rotors(**factors)
    r.rpm = command
    r.step(command, None, 0.0, 0.0)
    return r


def test_hover_thrust_carries_the_weight():
    assert abs(HOVER - 18968) < 20  # computed by hand from the L250 map
    assert settled((HOVER,) * 4).thrust_n == pytest.approx(WEIGHT_N, rel=1e-9)


@pytest.mark.parametrize("thrust_n", [0.013, 0.05, 0.0782, 0.12])
def test_thrust_map_and_its_inverse_agree(thrust_n):
    assert ROTOR.thrust_n(ROTOR.rpm(thrust_n)) == pytest.approx(thrust_n, rel=1e-12)


def test_thrust_never_pulls_down():
    for rpm in (0.0, 100.0, 1000.0, 2189.0):
        assert settled((rpm,) * 4).thrust_n == 0.0


def test_first_order_lag_has_its_time_constant():
    r = rotors()
    for _ in range(70):
        r.step((1000.0,) * 4, None, 0.0, 0.0)
    assert r.rpm[0] == pytest.approx(1000.0 * (1.0 - math.exp(-1.0)), rel=1e-9)


def test_lag_spread_scales_the_time_constant():
    r = rotors(motor_lag=1.3)
    for _ in range(91):
        r.step((1000.0,) * 4, None, 0.0, 0.0)
    assert r.rpm[0] == pytest.approx(1000.0 * (1.0 - math.exp(-1.0)), rel=1e-9)


@pytest.mark.parametrize(("step_rpm", "time_s"), [(100.0, 0.136), (-100.0, 0.108)])
def test_slow_motors_rise_and_fall_at_hover(step_rpm, time_s):
    r = rotors(slow=True)
    r.rpm = (HOVER,) * 4
    steps = 0
    while abs(r.rpm[0] - HOVER) < abs(step_rpm) * (1.0 - math.exp(-1.0)):
        r.step((HOVER + step_rpm,) * 4, None, 0.0, 0.0)
        steps += 1
    assert steps * STEP_S == pytest.approx(time_s, abs=0.002)


@pytest.mark.parametrize("motor", range(4))
def test_each_motor_turns_the_body_its_way(motor):
    faster = [HOVER] * 4
    faster[motor] += 500.0
    r = settled(tuple(faster))
    # r x F with F along z: torque (y F, -x F); a counter-clockwise rotor drags the body clockwise
    assert math.copysign(1, r.torque_x) == POSITION_Y[motor]
    assert math.copysign(1, r.torque_y) == -POSITION_X[motor]
    assert math.copysign(1, r.torque_z) == MIX_YAW[motor]
    more = ROTOR.thrust_n(HOVER + 500.0) - ROTOR.thrust_n(HOVER)
    assert abs(r.torque_x) == pytest.approx(more * ROTOR.arm_m, rel=1e-9)
    assert abs(r.torque_y) == pytest.approx(more * ROTOR.arm_m, rel=1e-9)


def test_drag_torque_is_the_identified_share_of_thrust():
    r = settled((HOVER, 0.0, HOVER, 0.0))  # both counter-clockwise
    assert -r.torque_z / r.thrust_n == pytest.approx(0.00735, rel=0.05)  # drone-models: thrust2torque


def test_spinning_up_a_counterclockwise_rotor_turns_the_body_clockwise():
    r = rotors()
    r.rpm = (HOVER,) * 4
    r.step((HOVER + 1000.0, HOVER, HOVER, HOVER), None, 0.0, 0.0)
    change = (r.rpm[0] - HOVER) * RAD_S_PER_RPM
    drag = settled(r.rpm).torque_z
    assert r.torque_z - drag == pytest.approx(-ROTOR.inertia_kg_m2 * change / STEP_S, rel=1e-9)


def test_gyroscopic_torque_is_minus_omega_cross_h():
    command = (20000.0, 15000.0, 20000.0, 15000.0)
    still, turning = settled(command), rotors()
    turning.rpm = command
    wx, wy = 3.0, -2.0
    turning.step(command, None, wx, wy)
    hz = -ROTOR.inertia_kg_m2 * sum(m * c for m, c in zip(MIX_YAW, command, strict=True)) * RAD_S_PER_RPM
    assert hz > 0.0  # counter-clockwise rotors are faster
    assert turning.torque_x - still.torque_x == pytest.approx(-wy * hz, rel=1e-9)
    assert turning.torque_y - still.torque_y == pytest.approx(wx * hz, rel=1e-9)
    assert turning.torque_z == still.torque_z


def test_thrust_spread_scales_thrust():
    assert settled((HOVER,) * 4, thrust=0.9).thrust_n == pytest.approx(0.9 * WEIGHT_N, rel=1e-9)


LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class TestGroundEffect:
    effect = GroundEffect(ROTOR, 1.0, 0.1)

    @pytest.mark.parametrize(("height_m", "increase"), [(0.030, 0.0385), (0.050, 0.0135)])
    def test_cheeseman_bennett(self, height_m, increase):
        assert self.effect.increase(height_m) == pytest.approx(increase, rel=0.01)

    def test_is_clipped_fades_out_and_never_jumps(self):
        assert self.effect.increase(0.005) == self.effect.increase(0.020)
        assert self.effect.increase(4.0 * ROTOR.radius_m) == 0.0
        values = [self.effect.increase(0.001 * k / 10.0) for k in range(1200)]
        assert max(abs(a - b) for a, b in itertools.pairwise(values)) < 1e-3
        assert all(a >= b for a, b in itertools.pairwise(values))

    def test_gain_multiplies_the_increase(self):
        assert GroundEffect(ROTOR, 4.0, 0.1).increase(0.03) == pytest.approx(4.0 * self.effect.increase(0.03))

    def test_standing_on_the_pad_all_four_gain(self):
        factors = self.effect.factors(0.0, 0.0, 0.0144, 0.2, LEVEL)
        assert factors == pytest.approx([1.0 + self.effect.increase(0.0264)] * 4)

    def test_at_the_edge_only_the_rotors_over_the_pad_gain(self):
        front_right, rear_right, rear_left, front_left = self.effect.factors(0.1, 0.0, 0.0144, 0.2, LEVEL)
        assert rear_right == rear_left > 1.03
        assert front_right == front_left == 1.0

    def test_floor_counts_away_from_the_pad(self):
        factors = self.effect.factors(1.0, 0.0, 0.0144 - 0.2, 0.2, LEVEL)
        assert factors == pytest.approx([1.0 + self.effect.increase(0.0264)] * 4)

    def test_nothing_near_nothing_gained(self):
        assert self.effect.factors(0.0, 0.0, 0.5, 0.2, LEVEL) == (1.0,) * 4
        assert self.effect.factors(1.0, 0.0, 0.1, 0.2, LEVEL) == (1.0,) * 4


def test_battery_sags_in_hover_and_drains_in_seven_minutes():
    battery = BatteryModel(PARAMS.battery, HOVER)
    assert battery.voltage_v == pytest.approx(4.14, abs=0.01)
    battery.step((HOVER,) * 4, 0.01)
    assert battery.voltage_v == pytest.approx(3.90, abs=0.01)
    assert battery.rpm_max > ROTOR.rpm(ROTOR.thrust_max_n)
    for _ in range(411):
        battery.step((HOVER,) * 4, 1.0)
    assert battery.voltage_v == pytest.approx(3.25, abs=0.01)
