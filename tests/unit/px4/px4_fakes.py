"""Imitates PX4 on its simulator link with pymavlink and sockets, without code of this project.

The imitation connects, sends HEARTBEAT and SET_MESSAGE_INTERVAL, and answers each HIL_SENSOR with one
HIL_ACTUATOR_CONTROLS. Its clock starts with the first HIL_SENSOR.
"""

from __future__ import annotations

import socket
import time

import numpy as np
from pymavlink.dialects.v20 import common as mav

PATIENCE_S = 30.0

# motors 1 to 4: position x forward, y to the right, and sense of rotation (1: counter-clockwise)
QUAD_X = np.array([[1, 1, 1], [-1, -1, 1], [1, -1, -1], [-1, 1, -1]], dtype=float)


def controlled_axes(parameters):
    """Return 1 for each of roll, pitch and yaw that PX4 controls (motor effectiveness above 0.05), else 0."""
    moments = np.array(
        [
            parameters.get(f"CA_ROTOR{i}_CT", 6.5) * parameters.get(f"CA_ROTOR{i}_{arm}", 1.0)
            for arm in ("PY", "PX", "KM")
            for i in range(4)
        ]
    ).reshape(3, 4)
    return (np.abs(moments).max(axis=1) > 0.05).astype(float)


class FakePx4:
    """Plays PX4: connects to the simulator, and exchanges messages with it."""

    def __init__(self, port):
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._socket.settimeout(PATIENCE_S)
        self.mav = mav.MAVLink(None, 1, 1)
        self.mav.robust_parsing = True
        self._waiting = []
        self.first_us = None
        self.pose = None
        self.counts = {}

    def send(self, *messages):
        self._socket.sendall(b"".join(bytes(m.pack(self.mav)) for m in messages))

    def raw(self, data):
        self._socket.sendall(data)

    def hello(self, autopilot=mav.MAV_AUTOPILOT_PX4):
        self.send(
            mav.MAVLink_heartbeat_message(0, autopilot, 0, 0, 0, 3),
            mav.MAVLink_command_long_message(0, 0, 511, 0, 115.0, 5000.0, 0, 0, 0, 0, 0),  # ignored message
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
        if kind == "ODOMETRY":
            self.pose = message
        return message

    def sensor(self):
        """Return the next HIL_SENSOR; None after a disconnection."""
        while (message := self.next()) is not None and message.get_type() != "HIL_SENSOR":
            pass
        if message is not None and self.first_us is None:
            self.first_us = message.time_usec
        return message

    def answer(self, sensor_us, controls, *, armed=True, flags=1):
        outputs = [float(c) for c in controls] + [0.0] * (16 - len(controls))
        time_us = sensor_us - self.first_us
        mode = 129 if armed else 1
        self.send(mav.MAVLink_hil_actuator_controls_message(time_us, outputs, mode, flags))

    def fly(self, until_s, controls=(0.0,) * 4, *, armed=False):
        """Answer each HIL_SENSOR with these motor outputs, up to ``until_s`` after the first HIL_SENSOR."""
        deadline_s = time.monotonic() + 4 * PATIENCE_S
        flown_s = 0.0
        while flown_s < until_s:
            assert time.monotonic() < deadline_s, "the flight took too long"
            sensor = self.sensor()
            assert sensor is not None, "the simulator has disconnected"
            self.answer(sensor.time_usec, controls, armed=armed)
            flown_s = (sensor.time_usec - self.first_us) * 1e-6

    def close(self):
        self._socket.close()


def parameters_of(text):
    """Return the parameters in a text whose lines end in NAME=VALUE or NAME VALUE."""
    words = (line.removeprefix("export PX4_PARAM_").replace("=", " ").split() for line in text.splitlines())
    return {name: float(value) for *_, name, value in words}
