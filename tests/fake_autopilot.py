"""Imitates ArduCopter, or PX4's parameter protocol, with any release and parameters, for companion tests.

In mode GUIDED the vehicle is a point that follows velocities in NED. The imitation shares no code with the
simulator.
"""

import math
import struct
import threading
import time

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint

GUIDED, LAND = 4, 9
FEET_M, LAG_S, SINK_M_S = 0.0144, 0.1, 0.3
PERIOD_S = 0.01


class FakeAutopilot:
    """Computes replies from messages and times; ``says_unknown``: unknown parameters get PARAM_ERROR."""

    def __init__(self, autopilot, version, parameters, *, says_unknown=True):
        self._px4 = autopilot == "px4"
        self._version, self._parameters, self._says_unknown = version, parameters, says_unknown
        self.asked, self.now_s = [], 0.0
        self.mode, self.armed, self.origin = 0, False, False
        self.position, self.velocity = [0.0, 0.0, -FEET_M], [0.0, 0.0, 0.0]
        self._wanted, self._until_s, self._climb_to_m = [0.0] * 3, -math.inf, None
        self._streams = {0: [1.0, 0.0]}  # message id: interval and next due time, s

    @property
    def standing(self):
        return self.position[2] >= -FEET_M - 1e-9

    def step(self, now_s):
        """Simulate the vehicle up to this time; return the telemetry that is due."""
        dt_s, self.now_s = min(now_s - self.now_s, 0.1), now_s
        wanted = [0.0, 0.0, SINK_M_S] if self.mode == LAND else list(self._wanted)
        if self._climb_to_m is not None:
            wanted = [0.0, 0.0, min(max(-self.position[2] - self._climb_to_m, -0.5), 0.5)]
        elif self.mode != LAND and now_s > self._until_s:
            wanted = [0.0] * 3
        if not self.armed:
            wanted = [0.0, 0.0, 3.0]
        for i in range(3):
            self.velocity[i] += min(dt_s / LAG_S, 1.0) * (wanted[i] - self.velocity[i])
            self.position[i] += dt_s * self.velocity[i]
        if self.position[2] > -FEET_M:
            self.position[2], self.velocity = -FEET_M, [0.0] * 3
            self.armed &= self.mode != LAND
        messages = []
        for number, stream in self._streams.items():
            if stream[1] <= now_s:
                stream[1] = max(stream[1] + stream[0], now_s - stream[0])
                messages += self._telemetry(number)
        return messages

    def _telemetry(self, number):
        ms, positioned = round(1e3 * self.now_s), self.origin and not self._px4
        if number == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            base = 1 | (128 if self.armed else 0)
            return [dialect.MAVLink_heartbeat_message(2, 12 if self._px4 else 3, base, self.mode, 3, 3)]
        if number == dialect.MAVLINK_MSG_ID_SYS_STATUS:
            health = dialect.MAV_SYS_STATUS_PREARM_CHECK if positioned and self.mode == GUIDED else 0
            return [dialect.MAVLink_sys_status_message(0, 0, health, 0, 12000, -1, 90, 0, 0, 0, 0, 0, 0)]
        if number == dialect.MAVLINK_MSG_ID_ATTITUDE:
            # yaw pi/2 (NED): the nose points east
            return [dialect.MAVLink_attitude_message(ms, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0)]
        if number == dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE:
            return [dialect.MAVLink_extended_sys_state_message(0, 1 if self.standing else 2)]
        if number == dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED and positioned:
            return [dialect.MAVLink_local_position_ned_message(ms, *self.position, *self.velocity)]
        if number == dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT and positioned:
            above_mm = round(-1e3 * (self.position[2] + FEET_M))
            return [dialect.MAVLink_global_position_int_message(ms, 0, 0, above_mm, above_mm, 0, 0, 0, 0)]
        return []

    def handle(self, m):
        self.asked.append(m)
        kind = m.get_type()
        if kind == "COMMAND_LONG":
            return self._command(m)
        if kind == "PARAM_REQUEST_READ":
            return self._parameter(m.param_id)
        if kind == "TIMESYNC" and m.tc1 == 0:
            return [dialect.MAVLink_timesync_message(round(1e9 * self.now_s) + 1, m.ts1)]
        if kind == "SET_GPS_GLOBAL_ORIGIN":
            self.origin = True
            return [dialect.MAVLink_gps_global_origin_message(m.latitude, m.longitude, m.altitude)]
        if kind == "SET_POSITION_TARGET_LOCAL_NED" and self.mode == GUIDED:
            self._wanted, self._climb_to_m = [m.vx, m.vy, m.vz], None  # a set-point ends the take-off
            self._until_s = self.now_s + self._parameters["GUID_TIMEOUT"]
        return []

    def _command(self, m):
        number, one = m.command, m.param1
        if number == dialect.MAV_CMD_REQUEST_MESSAGE and one == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            zeros, known = [0] * 8, self._version is not None
            answer = (0, self._version, 0, 0, 0, zeros, zeros, zeros, 0, 0, 0)
            return [dialect.MAVLink_autopilot_version_message(*answer)] if known else []
        if self._px4:
            return []  # the imitation of PX4 accepts no other command, and does not fly
        if number == dialect.MAV_CMD_REQUEST_MESSAGE:
            return self._telemetry(round(one))
        done = True
        if number == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            self._streams[round(one)] = [1e-6 * m.param2, self.now_s]
        elif number in (dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_CMD_NAV_LAND):
            self.mode, self._climb_to_m = LAND if number == 21 else round(m.param2), None
            self._streams[0][1] = self.now_s
        elif number == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            done = self.mode == GUIDED and self.origin if one else self.standing or m.param2 == 21196
            self.armed = bool(one) if done else self.armed
            self._streams[0][1] = self.now_s
        elif number == dialect.MAV_CMD_NAV_TAKEOFF:
            done = self.armed and self.mode == GUIDED
            self._climb_to_m = m.param7 + FEET_M if done else None
        return [dialect.MAVLink_command_ack_message(number, 0 if done else 4)]

    def _parameter(self, name):
        if name not in self._parameters:
            error = dialect.MAVLink_param_error_message(1, 191, name.encode(), -1, 1)
            return [error] if self._says_unknown else []
        kind, number = 9, float(self._parameters[name])
        if self._px4 and isinstance(self._parameters[name], int):  # PX4's encoding of integers
            kind, number = 6, struct.unpack("<f", struct.pack("<i", self._parameters[name]))[0]
        return [dialect.MAVLink_param_value_message(name.encode(), number, kind, len(self._parameters), 0)]


class Served:
    """Serves an autopilot (``step``, ``handle``) on a socket in a thread until ``close``."""

    def __init__(self, *given, **options):
        super().__init__(*given, **options)
        self.endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1)
        self.url = f"udpout:127.0.0.1:{self.endpoint.local_port}"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        begin_s = None  # time of the first message; no heartbeat is sent before
        while not self._over.is_set():
            if begin_s is not None:
                self.endpoint.send(self.step(time.monotonic() - begin_s))
            self.endpoint.wait(PERIOD_S)
            for received in self.endpoint.receive():
                begin_s = begin_s or time.monotonic()
                self.endpoint.send(self.handle(received.message), received.peer)

    def close(self):
        self._over.set()
        self._thread.join(10.0)
        self.endpoint.close()


class OnUdp(Served, FakeAutopilot):
    """The fake autopilot on a UDP socket."""
