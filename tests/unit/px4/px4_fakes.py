"""Imitates PX4 on its simulator link with pymavlink, sockets and textbook formulas, without project code.

It does what PX4 does on this link (connects, HEARTBEAT, SET_MESSAGE_INTERVAL, one HIL_ACTUATOR_CONTROLS for
each HIL_SENSOR, its clock starts with the first one) and flies by the sensors alone: attitude from gyro,
magnetometer and the velocity of the fixes, position from accelerometer and fixes, PX4's cascade with its
defaults, and its allocation for a quad X. All frames are NED and FRD.
"""

from __future__ import annotations

import math
import socket
import time

import numpy as np
from pymavlink.dialects.v20 import common as mav

PATIENCE_S = 30.0
GRAVITY = np.array([0.0, 0.0, 9.80665])
DECLINATION_RAD = math.radians(3.3)  # declination in Zurich
AROUND_M = 6_371_000.0
REST_STEPS = 100  # readings at rest at the start

# for outputs 1 to 4: x forward, y right, and 1 for counter-clockwise
QUAD_X = np.array([[1, 1, 1], [-1, -1, 1], [1, -1, -1], [-1, 1, -1]], dtype=float)


def allocate(thrust, roll, pitch, yaw):
    """Return outputs 1 to 4 of PX4's scaled allocation."""
    half = math.sqrt(0.5)
    x, y, spin = QUAD_X.T
    return np.clip(thrust - half * roll * y + half * pitch * x + yaw * spin, 0.0, 1.0)


def controlled_axes(parameters):
    """Return 1 for each of roll, pitch, yaw with a motor effectiveness above 0.05; PX4 drops other axes."""
    moments = np.array(
        [
            parameters.get(f"CA_ROTOR{i}_CT", 6.5) * parameters.get(f"CA_ROTOR{i}_{arm}", 1.0)
            for arm in ("PY", "PX", "KM")
            for i in range(4)
        ]
    ).reshape(3, 4)
    return (np.abs(moments).max(axis=1) > 0.05).astype(float)


def rotated(q):
    """Return the matrix of a quaternion (w, x, y, z): body to world."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(a, b):
    aw, av, bw, bv = a[0], a[1:], b[0], b[1:]
    return np.concatenate([[aw * bw - av @ bv], aw * bv + bw * av + np.cross(av, bv)])


def turned(q, by_body):
    """Return the attitude after a small rotation about body axes."""
    q = q + 0.5 * product(q, np.concatenate([[0.0], by_body]))
    return q / np.linalg.norm(q)


class Estimator:
    """Estimator of attitude, position and velocity from the sensors."""

    def __init__(self):
        self.rest = []
        self.q = None
        self.rates = self.bias = self.position = self.velocity = np.zeros(3)
        self.origin = None
        self.last_us = 0

    def sensor(self, m):
        accel, gyro = np.array([m.xacc, m.yacc, m.zacc]), np.array([m.xgyro, m.ygyro, m.zgyro])
        dt, self.last_us = (m.time_usec - self.last_us) * 1e-6, m.time_usec
        if self.q is None:
            self.rest.append((accel, gyro))
            if len(self.rest) >= REST_STEPS and m.fields_updated & 0x1C0:
                self._begin(np.array([m.xmag, m.ymag, m.zmag]))
            return
        self.rates = gyro - self.bias
        self.q = turned(self.q, self.rates * dt)
        acceleration = rotated(self.q) @ accel + GRAVITY
        self.position = self.position + self.velocity * dt + 0.5 * acceleration * dt * dt
        self.velocity = self.velocity + acceleration * dt
        if m.fields_updated & 0x1C0:
            self._turn(np.array([0.0, 0.0, 0.02 * self._heading_error(np.array([m.xmag, m.ymag, m.zmag]))]))

    def _begin(self, mag):
        accel, self.bias = (np.mean(list(values), axis=0) for values in zip(*self.rest, strict=True))
        roll = math.atan2(-accel[1], -accel[2])
        pitch = math.atan2(accel[0], math.hypot(accel[1], accel[2]))
        half = np.array([math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0])
        self.q = product(half, np.array([math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0]))
        self._turn(np.array([0.0, 0.0, self._heading_error(mag)]))

    def _heading_error(self, mag):
        north, east, _ = rotated(self.q) @ mag
        return math.remainder(DECLINATION_RAD - math.atan2(east, north), math.tau)

    def _turn(self, about_world):
        half = about_world / 2
        angle = float(np.linalg.norm(half))
        turn = np.concatenate([[math.cos(angle)], half * (math.sin(angle) / angle if angle else 1.0)])
        self.q = product(turn, self.q)

    def fix(self, m):
        if self.origin is None:
            self.origin = (m.lat, m.lon, m.alt)
        if self.q is None:
            return
        north = math.radians((m.lat - self.origin[0]) * 1e-7) * AROUND_M
        east = math.radians((m.lon - self.origin[1]) * 1e-7) * AROUND_M * math.cos(math.radians(m.lat * 1e-7))
        place = np.array([north, east, (self.origin[2] - m.alt) * 1e-3])
        error = np.array([m.vn, m.ve, m.vd]) * 1e-2 - self.velocity
        self.velocity = self.velocity + 0.2 * error
        self.position = self.position + 0.3 * (place - self.position)
        # an attitude error d turns gravity into an acceleration of (-g dy, g dx)
        self._turn(np.array([0.01 * error[1], -0.01 * error[0], 0.0]))

    def pose(self, m):
        """Correct with ODOMETRY, a pose of FRD in NED, instead of fixes."""
        if self.q is None:
            return
        found = np.array(m.q)
        self.q = self.q + 0.1 * (found * math.copysign(1.0, float(found @ self.q)) - self.q)
        self.q = self.q / np.linalg.norm(self.q)
        error = np.array([m.x, m.y, m.z]) - self.position
        self.position = self.position + 0.2 * error
        self.velocity = self.velocity + 0.8 * error


class Pilot:
    """PX4's cascade: default gains above the rate loop, and gains from its parameters below."""

    def __init__(self, parameters):
        self.p = parameters
        self.estimate = Estimator()
        self.goal = np.zeros(3)
        self.controlled = controlled_axes(parameters)
        self.armed = False
        self._velocity_i, self._rate_i = np.zeros(3), np.zeros(3)
        self._rates, self._slope = np.zeros(3), np.zeros(3)

    def controls(self, dt=0.004):
        if not self.armed or self.estimate.q is None:
            return np.zeros(4)
        hover = self.p["MPC_THR_HOVER"]
        force = self._acceleration(dt) - GRAVITY
        q = self.estimate.q
        thrust = hover / GRAVITY[2] * max(0.0, float(-force @ rotated(q)[:, 2]))
        return allocate(min(0.95, thrust), *self._torque(self._rate_goal(q, force), dt))

    def _acceleration(self, dt):
        e = self.estimate
        wish = np.array([0.95, 0.95, 1.0]) * (self.goal - e.position)
        flat = np.linalg.norm(wish[:2])
        wish[:2] *= min(1.0, 1.0 / flat) if flat else 1.0
        error = np.array([*wish[:2], np.clip(wish[2], -1.0, 0.7)]) - e.velocity
        self._velocity_i = np.clip(self._velocity_i + np.array([0.4, 0.4, 2.0]) * error * dt, -3.0, 3.0)
        wanted = np.array([1.8, 1.8, 4.0]) * error + self._velocity_i
        return np.clip(wanted, [-3.0, -3.0, -4.0], [3.0, 3.0, 4.0])

    def _rate_goal(self, q, force):
        down = -force / np.linalg.norm(force)
        right = np.cross(down, [0.0, 1.0, 0.0])  # nose to the east
        right /= np.linalg.norm(right)
        wanted = np.column_stack([np.cross(right, down), right, down])
        error = rotated(q).T @ wanted
        turn = 0.5 * np.array(
            [error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]]
        )
        gains = np.array([self.p["MC_ROLL_P"], self.p["MC_PITCH_P"], self.p["MC_YAW_P"]])
        return np.clip(gains * turn, -3.0, 3.0)

    def _torque(self, wanted, dt):
        rates = self.estimate.rates
        low_pass = dt / (dt + 1.0 / (2 * math.pi * 30.0))  # IMU_DGYRO_CUTOFF
        self._slope += low_pass * ((rates - self._rates) / dt - self._slope)
        self._rates = rates
        p, i, d = (
            np.array([self.p.get(f"MC_{axis}RATE_{term}", 0.0) for axis in ("ROLL", "PITCH", "YAW")])
            for term in "PID"
        )
        self._rate_i = np.clip(self._rate_i + i * (wanted - rates) * dt, -0.3, 0.3)
        return self.controlled * (p * (wanted - rates) + self._rate_i - d * self._slope)


class FakePx4:
    """The connection to the simulator."""

    def __init__(self, port):
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._socket.settimeout(PATIENCE_S)
        self.mav = mav.MAVLink(None, 1, 1)
        self.mav.robust_parsing = True
        self._waiting = []
        self.first_us = None
        self.truth = None
        self.counts = {}

    def send(self, *messages):
        self._socket.sendall(b"".join(bytes(m.pack(self.mav)) for m in messages))

    def raw(self, data):
        self._socket.sendall(data)

    def hello(self, autopilot=mav.MAV_AUTOPILOT_PX4):
        self.send(
            mav.MAVLink_heartbeat_message(0, autopilot, 0, 0, 0, 3),
            mav.MAVLink_command_long_message(0, 0, 511, 0, 115.0, 5000.0, 0, 0, 0, 0, 0),
        )

    def next(self):
        """Return the next message; None when the simulator has disconnected."""
        while not self._waiting:
            data = self._socket.recv(65536)
            if not data:
                return None
            self._waiting = self.mav.parse_buffer(data) or []
        message = self._waiting.pop(0)
        kind = message.get_type()
        self.counts[kind] = self.counts.get(kind, 0) + 1
        if kind == "HIL_STATE_QUATERNION":
            self.truth = message
        return message

    def sensor(self, pilot=None):
        """Return the next HIL_SENSOR; a pilot also gets all messages before it.

        None after a disconnection.
        """
        while True:
            message = self.next()
            if message is None:
                return None
            kind = message.get_type()
            if kind == "HIL_GPS" and pilot is not None:
                pilot.estimate.fix(message)
            if kind == "ODOMETRY" and pilot is not None:
                pilot.estimate.pose(message)
            if kind == "HIL_SENSOR":
                if self.first_us is None:
                    self.first_us = message.time_usec
                if pilot is not None:
                    pilot.estimate.sensor(message)
                return message

    def answer(self, sensor_us, controls, *, armed=True, flags=1):
        outputs = [float(c) for c in controls] + [0.0] * (16 - len(controls))
        time_us = sensor_us - self.first_us
        mode = 129 if armed else 1
        self.send(mav.MAVLink_hil_actuator_controls_message(time_us, outputs, mode, flags))

    def fly(self, pilot, until):
        """Answer every HIL_SENSOR until ``until(time of flight in s)``; return the last HIL_SENSOR."""
        deadline_s = time.monotonic() + 4 * PATIENCE_S
        while True:
            assert time.monotonic() < deadline_s, "the flight took too long"
            sensor = self.sensor(pilot)
            assert sensor is not None, "the simulator hung up"
            controls = pilot.controls()
            self.answer(sensor.time_usec, controls, armed=pilot.armed)
            if until((sensor.time_usec - self.first_us) * 1e-6):
                return sensor

    def close(self):
        self._socket.close()


def parameters_of(text):
    """Return the parameters of lines that end in NAME=VALUE or NAME VALUE."""
    words = (line.removeprefix("export PX4_PARAM_").replace("=", " ").split() for line in text.splitlines())
    return {name: float(value) for *_, name, value in words}


def true_place(fake):
    """Return north, east and up of the vehicle from the room's origin, m."""
    t = fake.truth
    north = math.radians(t.lat * 1e-7 - 47.397742) * AROUND_M
    east = math.radians(t.lon * 1e-7 - 8.545594) * AROUND_M * math.cos(math.radians(47.397742))
    return north, east, t.alt * 1e-3
