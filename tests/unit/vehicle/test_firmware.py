"""Controllers, mixer, supervisor, estimator."""

import math
import statistics

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.firmware import attitude as att
from sim.firmware.attitude import attitude_moments
from sim.firmware.estimator import ACCEL_XY_M_S2, ACCEL_Z_M_S2, Estimator, axis_gains, predict, yaw_gain
from sim.firmware.mixer import MapRecord, mix, motor_speed, set_up_map
from sim.firmware.paper_loop import PaperLoop, axes_from_force, paper_update
from sim.firmware.pid import THRUST_MIN, PidLoop, cascade_update, pid_output, pid_record
from sim.firmware.setpoint import SensedState, Setpoint, SetpointRecord
from sim.firmware.supervisor import PERIOD_MS, TRANSITIONS, State, Supervisor, supervise
from sim.plant.params import CONTROL_STEP_S, STEP_S, Plant, load
from sim.plant.rotation import quaternion_from_axes, rotation_axes
from sim.plant.rotors import Rotors, turn_rotors

PARAMS = load()
WEIGHT = PARAMS.body.mass_kg * PARAMS.contact.gravity_m_s2
HOVER_COUNTS = WEIGHT / 4.0 / 0.12 * 65535.0
PER_N = 65535.0 / (4 * 0.12)  # counts
LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
NO_RATES = (0.0, 0.0, 0.0)


def speeds_of(counts, rpm_max=1e9):
    thrust_map = set_up_map(new(MapRecord), PARAMS.rotor, PARAMS.battery)
    return [motor_speed(thrust_map, c, rpm_max) for c in counts]


def turned_at(speeds):
    """Wrench of rotors at these speeds."""
    rotors = Rotors(PARAMS.rotor, Plant(), False, STEP_S)
    rotors.rpm = speeds
    turn_rotors(rotors.record, np.array(speeds), 0.0, 0.0)
    return rotors.record


class TestMixer:
    @pytest.mark.parametrize(("axis", "torque"), [(0, "torque_x"), (1, "torque_y"), (2, "torque_z")])
    def test_a_positive_moment_turns_the_body_positively_and_nothing_else(self, axis, torque):
        moments = [0, 0, 0]
        moments[axis] = 2000
        speeds = speeds_of(mix(HOVER_COUNTS, tuple(moments)))
        rotors = turned_at(speeds)
        assert getattr(rotors, torque) > 0.0
        for other in {"torque_x", "torque_y", "torque_z"} - {torque}:
            assert abs(getattr(rotors, other)) < 0.02 * getattr(rotors, torque) + 1e-12
        assert rotors.thrust_n == pytest.approx(WEIGHT, rel=1e-6)

    def test_moment_per_count(self):
        speeds = speeds_of(mix(HOVER_COUNTS, (1000, 0, 0)))
        rotors = turned_at(speeds)
        assert rotors.torque_x / 1000 == pytest.approx(2 * 0.03253 * 0.12 / 65535, rel=1e-9)  # 1.191e-7 N m

    def test_below_the_smallest_thrust_a_motor_stops(self):
        least = 0.0128 / 0.12 * 65535.0
        assert speeds_of((least - 1.0, least + 1.0, 0.0, 0.0))[0] == 0.0
        assert PARAMS.rotor.thrust_n(speeds_of((0.0, least + 1.0, 0.0, 0.0))[1]) > 0.0128

    def test_counts_are_linear_in_thrust_and_the_battery_caps_the_speed(self):
        for counts in (10000.0, 42000.0, 65535.0):
            rpm = speeds_of((counts,) * 4)[2]
            assert PARAMS.rotor.thrust_n(rpm) == pytest.approx(0.12 * counts / 65535.0, rel=1e-12)
        assert speeds_of((65535.0,) * 4, 20000.0) == [20000.0] * 4


class TestMellingerAttitude:
    def test_rates_are_damped_and_their_change_resisted(self):
        a = PaperLoop(PARAMS).record.attitude
        assert attitude_moments(a, LEVEL, LEVEL, 0.1, -0.1, 0.1) == (-2000, 2000, -200)
        assert attitude_moments(a, LEVEL, LEVEL, 0.101, -0.1, 0.1) == (
            -2120,
            2000,
            -200,
        )  # 200 * 0.001 / 0.002

    def test_yaw_integral_pushes_on(self):
        loop = PaperLoop(PARAMS)
        a = loop.record.attitude
        turned = rotation_axes((math.cos(0.05), 0.0, 0.0, math.sin(0.05)))
        first = attitude_moments(a, turned, LEVEL, *NO_RATES)[2]
        for _ in range(500):
            last = attitude_moments(a, turned, LEVEL, *NO_RATES)[2]
        assert last - first == pytest.approx(-500 * 2 * math.sin(0.1), abs=2)
        loop.reset()
        assert attitude_moments(a, turned, LEVEL, *NO_RATES)[2] == first

    def test_gains_are_the_papers(self):
        assert (att.K_R_XY, att.K_R_Z) == (7e4, 0.5e4)
        assert (att.K_W_XY, att.K_W_Z) == (2e4, 0.2e4)


def sensed_at(velocity=(0.0, 0.0, 0.0), axes=LEVEL, rates=NO_RATES):
    sensed = new(SensedState)
    sensed.velocity, sensed.axes, sensed.rates = velocity, axes, rates
    return sensed


def paper(sensed, setpoint, level):
    return paper_update(PaperLoop(PARAMS).record, sensed, new(SetpointRecord, setpoint.fields()), level)


def pid(loop, sensed, setpoint, level):
    return cascade_update(loop.record, sensed, new(SetpointRecord, setpoint.fields()), level)


class TestPaperLoop:
    def test_hover_thrust_is_the_nominal_weight(self):
        counts, moments = paper(sensed_at(), Setpoint(), level=False)
        assert counts * 4 * 0.12 / 65535 == pytest.approx(WEIGHT, rel=1e-3)
        assert moments == (0, 0, 0)

    def test_equation_8(self):
        """The desired body axis is along -K_v (v - u) + m G; at that attitude all of it is thrust."""
        v, u = np.array([0.05, -0.02, 0.1]), np.array([0.15, 0.1, -0.1])
        force = -0.5 * (v - u) + np.array([0.0, 0.0, WEIGHT])
        axes = axes_from_force(*force.tolist(), 1.0, 0.0)
        counts, moments = paper(sensed_at(tuple(v), axes), Setpoint(*u), level=False)
        assert counts * 4 * 0.12 / 65535 == pytest.approx(np.linalg.norm(force), rel=1e-9)
        assert moments == (0, 0, 0)

    @pytest.mark.parametrize("u", [(0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, -0.2, 0.0)])
    def test_leans_where_it_wants_to_go(self, u):
        _, (mx, my, _) = paper(sensed_at(), Setpoint(*u), level=False)
        assert (np.sign(my), np.sign(-mx)) == (np.sign(u[0]), np.sign(u[1]))

    def test_axes_follow_force_and_yaw(self):
        axes = np.array(axes_from_force(0.1, -0.05, 0.3, math.cos(0.7), math.sin(0.7))).reshape(3, 3)
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.cross(axes[0], axes[1]) == pytest.approx(axes[2])
        assert axes[2] == pytest.approx(np.array([0.1, -0.05, 0.3]) / np.linalg.norm([0.1, -0.05, 0.3]))
        assert axes[1] @ np.array([math.cos(0.7), math.sin(0.7), 0.0]) == pytest.approx(0.0, abs=1e-12)

    def test_never_flies_upside_down(self):
        counts, _ = paper(sensed_at(), Setpoint(0.0, 0.0, -3.0), level=False)
        assert counts * 4 * 0.12 / 65535 == pytest.approx(0.2 * WEIGHT, rel=1e-6)

    def test_level_keeps_the_vertical_set_point_only(self):
        counts, moments = paper(sensed_at(), Setpoint(1.0, -1.0, -0.3), level=True)
        assert moments == (0, 0, 0)
        assert counts * 4 * 0.12 / 65535 == pytest.approx(WEIGHT - 0.15, rel=1e-6)

    def test_trim_is_the_inverse(self):
        force = (0.03, -0.01, 0.33)
        counts, moments = paper(
            sensed_at(axes=axes_from_force(*force, 1.0, 0.0)),
            Setpoint(*PaperLoop(PARAMS).trim(force, PER_N)),
            False,
        )
        assert counts * 4 * 0.12 / 65535 == pytest.approx(math.hypot(*force), rel=1e-9)
        assert moments == (0, 0, 0)


class TestPid:
    def test_single_pid(self):
        one = pid_record(2.0, 3.0, 0.5, 1.0, 0.1, 100.0)
        assert pid_output(one, 1.0, 5.0) == pytest.approx(2.0 + 3.0 * 0.1)
        assert pid_output(one, 1.0, 5.2) == pytest.approx(2.0 + 3.0 * 0.2 - 0.5 * 2.0)
        for _ in range(100):
            pid_output(one, 1.0, 5.2)
        assert one.integral == 1.0
        assert pid_output(pid_record(2.0, 0.0, 0.0, 1.0, 0.1, 1.5), 1.0, 0.0) == 1.5

    def test_base_thrust_and_limits(self):
        up, _ = pid(PidLoop(PARAMS), sensed_at(), Setpoint(), level=False)
        assert up == 36000.0
        down, _ = pid(PidLoop(PARAMS), sensed_at(), Setpoint(0.0, 0.0, -5.0), level=False)
        assert down == THRUST_MIN

    @pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
    def test_leans_where_it_wants_to_go_whatever_the_yaw(self, yaw):
        axes = rotation_axes((math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))
        loop = PidLoop(PARAMS)
        _, (mx, my, _) = pid(loop, sensed_at(axes=axes), Setpoint(0.2, 0.0, 0.0, yaw), level=False)
        # torque axis must be z cross the wish, in the world: east wanted, torque about north
        assert math.atan2(mx * axes[1] + my * axes[4], mx * axes[0] + my * axes[3]) == pytest.approx(
            math.pi / 2, abs=1e-3
        )

    def test_tilt_is_limited_to_20_degrees(self):
        tilt = math.radians(20.0)
        axes = rotation_axes((math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0))
        _, moments = pid(PidLoop(PARAMS), sensed_at(axes=axes), Setpoint(5.0, 0.0, 0.0), level=False)
        assert moments == pytest.approx((0, 0, 0), abs=1)

    @pytest.mark.parametrize("force", [(0.05, 0.0, 0.33), (0.0, -0.05, 0.33), (0.0, 0.0, 0.4)])
    def test_trim_holds(self, force):
        loop = PidLoop(PARAMS)
        setpoint = Setpoint(*loop.trim(force, PER_N))
        counts, moments = pid(loop, sensed_at(axes=axes_from_force(*force, 1.0, 0.0)), setpoint, level=False)
        assert counts * 4 * 0.12 / 65535 == pytest.approx(math.hypot(*force), rel=1e-9)
        assert moments == pytest.approx((0, 0, 0), abs=1)

    def test_levelling_out_resets_and_levels(self):
        loop = PidLoop(PARAMS)
        loop.trim((0.05, 0.0, 0.33), PER_N)
        pid(loop, sensed_at(), Setpoint(), level=False)
        counts, moments = pid(loop, sensed_at(), Setpoint(1.0, 0.0, 0.0), level=True)
        assert counts == 36000.0
        assert moments == (0, 0, 0)

    def test_yaw_takes_the_short_way(self):
        axes = rotation_axes((math.cos(1.5), 0.0, 0.0, math.sin(1.5)))  # yaw 3.0
        _, (_, _, mz) = pid(PidLoop(PARAMS), sensed_at(axes=axes), Setpoint(yaw_rad=-3.0), level=False)
        assert mz > 0


class TestSupervisor:
    UPRIGHT = (0.0, 0.0, 1.0)

    def run(self, supervisor, start_ms, stop_ms, age=lambda now: 0, motors=True, accel=UPRIGHT):
        """Returns when each state was entered last."""
        entered = {}
        for now in range(start_ms, stop_ms, PERIOD_MS):
            before = supervisor.state
            supervise(supervisor.record, now, age(now), motors, *accel)
            if supervisor.state is not before:
                entered[supervisor.state] = now
        return entered

    def flying(self):
        supervisor = Supervisor()
        assert supervisor.arm(0) is None
        self.run(supervisor, 0, 1000)
        assert supervisor.state is State.FLYING
        return supervisor

    def test_every_state_has_its_transitions(self):
        assert set(TRANSITIONS) == set(State)

    def test_set_points_that_stop_level_out_at_520_and_lock_at_2040(self):
        supervisor = self.flying()
        last = 1000
        entered = self.run(supervisor, 1000, 4000, age=lambda now: now - last)
        assert entered[State.LEVEL_OUT] - last == 520
        assert entered[State.LOCKED] - last == 2040
        assert not supervisor.motors_allowed
        assert "reboot" in supervisor.arm(5000)
        supervisor.disarm(5000)
        assert supervisor.state is State.LOCKED

    def test_waits_thirty_seconds_for_the_motors(self):
        supervisor = Supervisor()
        supervisor.arm(0)
        self.run(supervisor, 0, 29_000, motors=False, age=lambda now: now)
        assert supervisor.state is State.READY
        self.run(supervisor, 29_000, 31_000, motors=False)
        assert supervisor.state is State.DISARMED

    @pytest.mark.parametrize(
        ("accel", "crashed"),
        [
            ((0.0, 0.9, 0.4), True),
            ((0.0, 0.0, -1.0), True),
            ((0.02, 0.0, 0.05), False),
            ((0.0, 0.0, 0.6), False),
        ],
    )
    def test_tumble(self, accel, crashed):
        supervisor = self.flying()
        self.run(supervisor, 1000, 2200, accel=accel)
        assert (supervisor.state is State.CRASHED) is crashed

    def test_crashed_needs_a_disarm(self):
        supervisor = self.flying()
        self.run(supervisor, 1000, 1300, accel=(0.0, 0.0, -1.0))
        assert "tumbled" in supervisor.arm(2000)
        supervisor.disarm(2000)
        assert supervisor.arm(2000) is None


class TestEstimator:
    @pytest.mark.parametrize("rate_hz", [50.0, 100.0])
    @pytest.mark.parametrize("accel", [ACCEL_XY_M_S2, ACCEL_Z_M_S2])
    def test_gains_are_the_kalman_filters_and_stable(self, rate_hz, accel):
        scipy_linalg = pytest.importorskip("scipy.linalg")
        t = 1.0 / rate_hz
        k = np.array(axis_gains(t, accel, 9.81))
        f = np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
        poles = np.linalg.eigvals((np.eye(3) - np.outer(k, [1.0, 0.0, 0.0])) @ f)
        assert max(abs(poles)) < math.exp(-t / 2.0)  # forgets within 2 s
        velocity, walk = accel**2 * 1e-3, (9.81 * 0.1) ** 2 * 1e-3
        q = velocity * np.array([[t**3 / 3, t**2 / 2, 0], [t**2 / 2, t, 0], [0, 0, 0]]) + walk * np.array(
            [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
        )
        p = scipy_linalg.solve_discrete_are(f.T, np.array([[1.0], [0.0], [0.0]]), q, np.array([[1e-4]]))
        assert k == pytest.approx(p[:, 0] / (p[0, 0] + 1e-4), rel=1e-6)

    def test_yaw_gain_solves_its_riccati_equation(self):
        k, q, r = yaw_gain(0.01), 1e-2 * 1e-3 * 0.01, (9e-3) ** 2
        p = k * r / (1.0 - k)
        assert (1.0 - k) * p + q == pytest.approx(p, rel=1e-9)

    def test_integrates_the_gyro_and_the_accelerometer(self):
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        for _ in range(500):
            predict(estimator.record, np.array((0.0, 0.0, 1.0)), np.array((0.0, 0.0, 9.81 + 0.5)))
        sensed = estimator.sensed
        assert math.atan2(sensed.axes[1], sensed.axes[0]) == pytest.approx(1.0, abs=1e-4)
        assert sensed.velocity == pytest.approx((0.0, 0.0, 0.5), abs=1e-9)
        assert sensed.position == pytest.approx((0.0, 0.0, 0.25), abs=1e-9)

    @pytest.mark.parametrize("start", [(0.05, 0.0), (0.0, -0.05)])
    def test_a_wrong_tilt_is_found_from_position(self, start):
        roll, pitch = start
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        half = 0.5 * (roll or pitch)
        tilted = (math.cos(half), math.sin(half) if roll else 0.0, math.sin(half) if pitch else 0.0, 0.0)
        estimator.settle((0.0, 0.0, 1.0), NO_RATES, rotation_axes(tilted), tilted, [0.0, 0.0, 0.0])
        for k in range(5000):
            predict(
                estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81))
            )  # in truth level and at rest
            if k % 5 == 0:
                estimator.correct(0.0, 0.0, 1.0, 0.0)
        assert estimator.sensed.axes[6:8] == pytest.approx((0.0, 0.0), abs=1e-4)
        assert estimator.sensed.velocity == pytest.approx(NO_RATES, abs=1e-4)

    def test_a_late_capture_makes_the_position_late_and_the_velocity_right(self):
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        speed, delay = 1.0, 0.02
        estimator.settle((0.0, 0.0, 1.0), (speed, 0.0, 0.0), LEVEL, (1.0, 0.0, 0.0, 0.0), [0.0, 0.0, 0.0])
        for k in range(1, 5001):
            predict(estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81)))
            if k % 5 == 0:
                estimator.correct(speed * (k * CONTROL_STEP_S - delay), 0.0, 1.0, 0.0)
        assert estimator.sensed.position[0] == pytest.approx(speed * (10.0 - delay), abs=1e-4)
        assert estimator.sensed.velocity[0] == pytest.approx(speed, abs=1e-4)

    def test_starts_balanced_whatever_the_bias(self):
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        tilted = quaternion_from_axes(axes_from_force(0.05, -0.03, 0.3, 1.0, 0.0))
        axes, bias = rotation_axes(tilted), [0.05, -0.03, 0.08]
        estimator.settle((0.0, 0.0, 1.0), NO_RATES, axes, tilted, bias)
        accel = tuple(9.81 * axes[i] + b for i, b in zip((2, 5, 8), bias, strict=True))
        predict(estimator.record, np.array(NO_RATES), np.array(accel))
        assert estimator.sensed.velocity == pytest.approx(NO_RATES, abs=2e-6)

    def test_noise_of_a_still_estimate(self):
        rng = np.random.default_rng(3)
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        estimator.settle((0.0, 0.0, 1.0), NO_RATES, LEVEL, (1.0, 0.0, 0.0, 0.0), [0.0, 0.0, 0.0])
        position, velocity = [], []
        for k in range(20_000):
            predict(estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81)))
            if k % 5 == 0:
                n = 0.005 * rng.standard_normal(4)
                estimator.correct(n[0], n[1], 1.0 + n[2], n[3])
                position.append(estimator.sensed.position[0])
                velocity.append(estimator.sensed.velocity[0])
        assert statistics.pstdev(position) == pytest.approx(0.0015, rel=0.3)  # of 5 mm
        assert 0.002 < statistics.pstdev(velocity) < 0.008

    def test_is_invalid_without_samples(self):
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        for _ in range(240):
            predict(estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81)))
        assert estimator.valid
        for _ in range(20):
            predict(estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81)))
        assert not estimator.valid
