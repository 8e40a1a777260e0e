"""Model of the Crazyflie's CRTP interface: computes the answers to cflib from packets and times.

Undocumented behaviour was measured on firmware 2026.08, compiled for a PC.
"""

import struct
from collections import deque
from dataclasses import dataclass
from typing import Any

from bridge.frames import body_from_world
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import PERIOD_S, State, Supervisor
from tests.crazyflie_firmware.tables import CODE, LOGS, Param, log_toc, param_toc, params, quaternion_bits

STOP, VELOCITY_WORLD = 0, 8
UP = (0.0, 0.0, 1.0)
SILENT_S = 1.0  # time without any packet after which the log blocks are deleted, s (crtp.c, log.c)
START_S = 3.0  # duration of a start, s; the firmware arms itself 3.1 s after power-on


@dataclass
class Block:
    names: list[str]
    period_s: float = 0.0
    due_s: float = 0.0
    running: bool = False


class Firmware:
    """Model of the firmware of one Crazyflie: receives CRTP packets and returns the answers.

    ``protocol``: version of CRTP; below 12 the model is CrazySim's firmware of 2024, without supervisor port;
    ``tables``: numbers of log variables and of parameters; the real firmware has 567 and 334.
    """

    def __init__(
        self,
        plant: Any = None,
        *,
        protocol: int = 12,
        auto_arm: bool = True,
        needs_poses: bool = False,
        clock_rate: float = 1.0,
        tables: tuple[int, int] = (0, 0),
    ):
        self.plant = plant if plant is not None else Point()
        self.protocol = protocol
        self.needs_poses = needs_poses  # whether the position is valid only as long as poses arrive
        self.clock_rate = clock_rate  # ratio of firmware clock to host clock; 0.97 measured in CrazySim
        self.battery_v = 4.1
        self.power_state = 0
        # (time, velocity, yaw rate in deg/s) of the newest velocity set-points
        self.setpoints: deque = deque(maxlen=4096)
        self.poses: deque = deque(maxlen=4096)  # (time, position and quaternion) of the newest external poses
        self.refuse_arming = False
        self._auto_arm, self._tables = auto_arm, tables
        self._host_s = self._now_s = self._stepped_s = self._stalled_until_s = self._started_s = 0.0
        self._start()

    def _start(self) -> None:
        """Set the state that the firmware has after a start."""
        self.supervisor = Supervisor(self._auto_arm)
        self.params: dict[str, Param] = params(self._tables[1])
        self._log_toc, self._param_toc = log_toc(self.protocol, self._tables[0]), param_toc(self.params)
        self._blocks: dict[int, Block] = {}
        self._setpoint: tuple[tuple[float, float, float], float] | None = None
        self._setpoint_s = -1e9
        self._priority = 0
        self._heard_s = self._supervised_s = self._now_s
        self._boot_s = self._now_s  # time of the start, s; log data have times since this start

    def restart(self) -> None:
        """Restart now, also in the air: for some seconds the firmware sends nothing, then it arms itself."""
        self._start()
        self._started_s = self._now_s + START_S
        self._supervised_s = self._started_s
        self.plant.restart()

    def stall(self, seconds: float) -> None:
        """Freeze vehicle and clock for this time, as a simulator without processor time does."""
        self._stalled_until_s = self._host_s + seconds

    def _clock(self, host_s: float) -> float:
        """Advance to a time of the host clock; return the time of the firmware clock."""
        begin_s = max(self._host_s, min(self._stalled_until_s, host_s))
        self._now_s += self.clock_rate * (host_s - begin_s)
        self._host_s = host_s
        return self._now_s

    def packet(self, raw: bytes, now_s: float) -> list[bytes]:
        """Return the answers to one packet; ``now_s`` is on the host's clock, as in all public methods."""
        stalls, now_s = now_s < self._stalled_until_s, self._clock(now_s)
        if stalls or now_s < self._started_s:
            return []
        self._heard_s = now_s
        port, channel, data = raw[0] >> 4, raw[0] & 3, raw[1:]
        if port == 15 and channel == 3:
            return []  # a null packet has no answer
        handler = {
            (15, 0): lambda: [data],
            (15, 1): lambda: [b"Bitcraze Crazyflie".ljust(30, b"\0")],
            (13, 1): lambda: [data[:1] + struct.pack("<i", self.protocol)] if data[:1] == b"\0" else [],
            (5, 0): lambda: self._toc(self._log_toc, data),
            (5, 1): lambda: self._log_control(data, now_s),
            (4, 0): lambda: [b"\x01\x00"],
            (2, 0): lambda: self._toc(self._param_toc, data),
            (2, 1): lambda: self._param_read(data),
            (2, 2): lambda: self._param_write(data),
            (3, 0): lambda: self._thrust(data, now_s),
            (6, 1): lambda: self._generic_location(data, now_s),
            (7, 0): lambda: self._generic_setpoint(data, now_s),
            (7, 1): lambda: self._notify(),
            (9, 0): lambda: (
                [b"\x8c" + struct.pack("<H", self.supervisor.info)] if self.protocol >= 12 else []
            ),
            (9, 1): lambda: self._supervise(data),
        }.get((port, channel))
        head = bytes((port << 4 | 0x0C | channel,))
        return [] if handler is None else [head + answer for answer in handler()]

    def step(self, now_s: float) -> list[bytes]:
        """Advance to a time; return the due log packets."""
        stalls, now_s = now_s < self._stalled_until_s, self._clock(now_s)
        dt_s, self._stepped_s = now_s - self._stepped_s, now_s
        while now_s - self._supervised_s >= PERIOD_S:
            self._supervised_s += PERIOD_S  # the supervisor's period is fixed, also if the host is late
            # with priority 0 the firmware's planner makes the set-points, so the watchdog does not act
            age_s = self._supervised_s - self._setpoint_s if self._priority else 0.0
            self.supervisor.setpoints_rule = self._priority > 0
            self.supervisor.step(self._supervised_s, age_s, self.plant.motors)
        level = self.supervisor.state is State.LEVEL_OUT
        if self._setpoint is None or not self.supervisor.motors_may_run:
            self.plant.motors_off()
        else:
            self.plant.command(*self._setpoint, level)
        if not self.needs_poses:
            self.plant.pose(*self.plant.position, None)
        self.plant.advance(dt_s)
        if now_s - self._heard_s > SILENT_S:
            self._blocks.clear()
        if stalls or now_s < self._started_s:
            return []
        return [self._data(i, b, now_s) for i, b in self._blocks.items() if self._is_due(b, now_s)]

    # Tables of log variables and parameters

    def _toc(self, toc: Any, data: bytes) -> list[bytes]:
        if data[0] == 3:
            return [toc.info()]
        return [toc.item(struct.unpack_from("<H", data, 1)[0])] if data[0] == 2 else []

    def _log_control(self, data: bytes, now_s: float) -> list[bytes]:
        command, number = data[0], data[1] if len(data) > 1 else 0
        if command == 5:
            self._blocks.clear()
        elif command == 6:
            ids = [struct.unpack_from("<H", data, at)[0] for at in range(3, len(data), 3)]
            if number in self._blocks:
                return [bytes((command, number, 17))]  # errno EEXIST
            self._blocks[number] = Block([self._log_toc.name(i) for i in ids])
        elif command in (3, 7) and number not in self._blocks:
            return [bytes((command, number, 2))]  # errno ENOENT
        elif command == 7:
            ids = [struct.unpack_from("<H", data, at)[0] for at in range(3, len(data), 3)]
            names = [*self._blocks[number].names, *(self._log_toc.name(i) for i in ids)]
            if sum(struct.calcsize(CODE[LOGS[name]]) for name in names) > 26:
                return [bytes((command, number, 7))]  # errno E2BIG: reply to a repeated request
            self._blocks[number].names = names
        elif command == 3:
            block = self._blocks[number]
            block.period_s, block.running, block.due_s = data[2] / 100.0, True, now_s
        elif command in (2, 4):
            self._blocks.pop(number, None)
        return [bytes((command, number, 0))]

    def _is_due(self, block: Block, now_s: float) -> bool:
        if not block.running or now_s < block.due_s:
            return False
        block.due_s = max(block.due_s + block.period_s, now_s - block.period_s)
        return True

    def _data(self, number: int, block: Block, now_s: float) -> bytes:
        values = self._values()
        body = b"".join(struct.pack(CODE[LOGS[name]], values[name]) for name in block.names)
        assert len(body) <= 26, "no more fits a log packet"
        time_ms = int((now_s - self._boot_s) * 1000) & 0xFFFFFF
        return b"\x5e" + bytes((number,)) + time_ms.to_bytes(3, "little") + body

    def _values(self) -> dict[str, Any]:
        plant = self.plant
        position, velocity = plant.estimate
        # mm, mm/s, mrad/s, truncated towards zero and to 16 bits (stabilizer.c, compressState)
        (x, y, z), (vx, vy, vz), (p, q, r) = (
            [(int(1000 * e) + (1 << 15)) % (1 << 16) - (1 << 15) for e in vector]
            for vector in (position, velocity, plant.rates)
        )
        attitude = plant.quaternion
        if self.needs_poses and self.poses:
            # the firmware's filter takes the tilt from the newest pose
            x_, y_, z_, w_ = self.poses[-1][1][3:]
            attitude = (w_, x_, y_, z_)
        variance = plant.variance_m2 if self.params["stabilizer.estimator"].value == 2 else 0.0
        state = (x, y, z, vx, vy, vz, quaternion_bits(attitude), p, -q, r)
        return {
            **dict(zip(LOGS, state, strict=False)),
            "supervisor.info": self.supervisor.info,
            "pm.vbat": self.battery_v,
            "pm.vbatMV": round(1000 * self.battery_v),
            "pm.state": self.power_state,
            "pm.batteryLevel": 90,
            **dict(zip(("acc.x", "acc.y", "acc.z"), body_from_world(plant.quaternion, UP), strict=True)),
            **{
                f"motor.m{number}": (50_000 + 1_000 * number) * self.supervisor.armed
                for number in range(1, 5)
            },
            **{f"kalman.varP{axis}": variance for axis in "XYZ"},
        }

    def _param_read(self, data: bytes) -> list[bytes]:
        param = self.params[self._param_toc.name(struct.unpack_from("<H", data)[0])]
        return [data[:2] + b"\0" + struct.pack(CODE[param.kind], param.value)]

    def _param_write(self, data: bytes) -> list[bytes]:
        param = self.params[self._param_toc.name(struct.unpack_from("<H", data)[0])]
        if not param.read_only:
            (param.value,) = struct.unpack_from(CODE[param.kind], data, 2)
            self.written()
        return [data[:2] + struct.pack(CODE[param.kind], param.value)]

    def written(self) -> None:
        """Pass the estimator's parameters to the plant after a write."""
        drag = [self.params.get(f"kalman.dragB_{axis}") for axis in "xyz"]
        if self.params["kalman.resetEstimation"].value:
            self.plant.reset(*(self.params[f"kalman.initial{name}"].value for name in ("X", "Y", "Z", "Yaw")))
        self.plant.know_drag(tuple(param.value if param else 0.0 for param in drag))

    # Packets with set-points

    def _generic_setpoint(self, data: bytes, now_s: float) -> list[bytes]:
        kind = data[0]
        assert len(data) == {STOP: 1, VELOCITY_WORLD: 17}[kind], "a wrong length restarts the firmware"
        self._setpoint_s, self._priority = now_s, 2
        if kind == STOP:
            self._setpoint = None
            return []
        vx, vy, vz, yaw_rate_deg_s = struct.unpack_from("<4f", data, 1)
        self._setpoint = ((vx, vy, vz), yaw_rate_deg_s * 0.017453292519943295)
        self.setpoints.append((now_s, (vx, vy, vz), yaw_rate_deg_s))
        self.plant.setpoint(*self._setpoint)
        return []

    def _thrust(self, data: bytes, now_s: float) -> list[bytes]:
        """Handle roll, pitch, yaw rate and thrust; cflib sends only a final thrust of zero."""
        assert struct.unpack("<fffH", data)[3] == 0
        self._setpoint_s, self._priority, self._setpoint = now_s, 2, None
        return []

    def _notify(self) -> list[bytes]:
        self._priority, self._setpoint = 0, None
        return []

    def _generic_location(self, data: bytes, now_s: float) -> list[bytes]:
        if data[0] == 8:
            pose = struct.unpack_from("<7f", data, 1)
            self.poses.append((now_s, pose))
            if self.needs_poses:
                self.plant.pose(*pose[:3], pose[3:])
        elif data[0] == 3 and self.protocol < 12:
            self.supervisor.emergency = True
        return []

    def _supervise(self, data: bytes) -> list[bytes]:
        if self.protocol < 12:
            return []
        if data[0] == 1:
            done = False if self.refuse_arming and data[1] else self.supervisor.request(bool(data[1]))
            return [bytes((0x81, done, self.supervisor.armed))]
        if data[0] == 2:
            done = self.supervisor.recover()
            return [bytes((0x82, done, not self.supervisor.crashed))]
        if data[0] == 3:
            self.supervisor.emergency = True
        return []
