"""CRTP in, CRTP out: what a Crazyflie answers to cflib, from bytes and times alone."""

import struct
import zlib
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.supervisor import PERIOD_S, State, Supervisor

STOP, VELOCITY_WORLD = 0, 8
PORTS = {
    "console": 0,
    "param": 2,
    "commander": 3,
    "mem": 4,
    "log": 5,
    "loc": 6,
    "generic": 7,
    "supervisor": 9,
}
SETTLED_M2, UNKNOWN_M2 = 1e-5, 100.0


@dataclass
class Block:
    """A log block."""

    names: list[str]
    period_s: float = 0.0
    due_s: float = 0.0
    running: bool = False


class Firmware:
    """One Crazyflie.

    Attributes:
        setpoints: (time, velocity, yaw rate in deg/s) of the last velocity set-points.
        poses: (time, seven numbers) of the last poses from outside.
        legs: what else arrived: "stop", "notify", "arm", "disarm", "emergency", "rpyt".
        needs_poses: it knows where it is only while poses come.
    """

    def __init__(
        self, plant: Any = None, *, protocol: int = 12, auto_arm: bool = True, needs_poses: bool = False
    ):
        self.plant = plant if plant is not None else Point()
        self.supervisor = Supervisor(auto_arm)
        self.protocol = protocol
        self.needs_poses = needs_poses
        self.battery_v = 4.1
        self.power_state = 0
        self.params: dict[str, Param] = params()
        self.setpoints: deque = deque(maxlen=4096)
        self.poses: deque = deque(maxlen=4096)
        self.legs: deque = deque(maxlen=4096)
        self.refuse_arming = False
        self._log_toc, self._param_toc = log_toc(), param_toc(self.params)
        self._blocks: dict[int, Block] = {}
        self._setpoint: tuple[tuple[float, float, float], float] | None = None
        self._setpoint_s = -1e9
        self._priority = 0
        self._supervised_s = 0.0
        self._stepped_s = 0.0

    def packet(self, raw: bytes, now_s: float) -> list[bytes]:
        """Answer one packet."""
        port, channel, data = raw[0] >> 4, raw[0] & 3, raw[1:]
        if port == 15 and channel == 3:
            return []  # null packet
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
            (7, 1): lambda: self._notify(now_s),
            (9, 0): lambda: (
                [b"\x8c" + struct.pack("<H", self.supervisor.info)] if self.protocol >= 12 else []
            ),
            (9, 1): lambda: self._supervise(data, now_s),
        }.get((port, channel))
        head = bytes((port << 4 | 0x0C | channel,))
        return [] if handler is None else [head + answer for answer in handler()]

    def step(self, now_s: float) -> list[bytes]:
        """Advance to a time; returns the log packets that are due."""
        dt_s, self._stepped_s = now_s - self._stepped_s, now_s
        while now_s - self._supervised_s >= PERIOD_S:
            self._supervised_s += PERIOD_S  # its own period, also when the host runs this late
            # relaxed, it is fed by the planner
            age_s = self._supervised_s - self._setpoint_s if self._priority else 0.0
            self.supervisor.step(self._supervised_s, age_s, self.plant.motors)
        level = self.supervisor.state is State.LEVEL_OUT
        if self._setpoint is None or not self.supervisor.motors_may_run:
            self.plant.motors_off()
        else:
            self.plant.command(*self._setpoint, level)
        self.plant.advance(dt_s)
        return [self._data(i, b, now_s) for i, b in self._blocks.items() if self._is_due(b, now_s)]

    # Log and parameters

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
                return [bytes((command, number, 17))]  # EEXIST
            self._blocks[number] = Block([self._log_toc.name(i) for i in ids])
        elif command in (3, 7) and number not in self._blocks:
            return [bytes((command, number, 2))]  # ENOENT
        elif command == 7:
            ids = [struct.unpack_from("<H", data, at)[0] for at in range(3, len(data), 3)]
            names = [*self._blocks[number].names, *(self._log_toc.name(i) for i in ids)]
            if sum(struct.calcsize(CODE[LOGS[name]]) for name in names) > 26:
                return [bytes((command, number, 7))]  # E2BIG, as when the same is asked twice
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
        values = self._values(now_s)
        body = b"".join(struct.pack(CODE[LOGS[name]], values[name]) for name in block.names)
        assert len(body) <= 26, "no more fits a log packet"
        time_ms = int(now_s * 1000) & 0xFFFFFF
        return b"\x5e" + bytes((number,)) + time_ms.to_bytes(3, "little") + body

    def _values(self, now_s: float) -> dict[str, Any]:
        plant = self.plant
        (x, y, z), (vx, vy, vz), (p, q, r) = (
            [round(1000 * e) for e in vector] for vector in (plant.position, plant.velocity, plant.rates)
        )
        known = not self.needs_poses or bool(self.poses and now_s - self.poses[-1][0] < 0.5)
        variance = SETTLED_M2 if known else UNKNOWN_M2
        if self.params["stabilizer.estimator"].value != 2:
            variance = 0.0  # the filter does not run
        state = (x, y, z, vx, vy, vz, quaternion_bits(plant.quaternion), p, -q, r)
        return {
            **dict(zip(LOGS, state, strict=False)),
            "supervisor.info": self.supervisor.info,
            "pm.vbat": self.battery_v,
            "pm.vbatMV": round(1000 * self.battery_v),
            "pm.state": self.power_state,
            "pm.batteryLevel": 90,
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
        return [data[:2] + struct.pack(CODE[param.kind], param.value)]

    # Flying

    def _note(self, what: str, now_s: float) -> list[bytes]:
        self.legs.append((now_s, what))
        return []

    def _generic_setpoint(self, data: bytes, now_s: float) -> list[bytes]:
        kind = data[0]
        assert len(data) == {STOP: 1, VELOCITY_WORLD: 17}[kind], "a wrong length restarts the firmware"
        self._setpoint_s, self._priority = now_s, 2
        if kind == STOP:
            self._setpoint = None
            return self._note("stop", now_s)
        vx, vy, vz, yaw_rate_deg_s = struct.unpack_from("<4f", data, 1)
        self._setpoint = ((vx, vy, vz), yaw_rate_deg_s * 0.017453292519943295)
        self.setpoints.append((now_s, (vx, vy, vz), yaw_rate_deg_s))
        self.plant.setpoint(*self._setpoint)
        return []

    def _thrust(self, data: bytes, now_s: float) -> list[bytes]:
        """Roll, pitch, yaw rate and thrust: only the thrust of zero that cflib ends a link with."""
        assert struct.unpack("<fffH", data)[3] == 0
        self._setpoint_s, self._priority, self._setpoint = now_s, 2, None
        return self._note("rpyt", now_s)

    def _notify(self, now_s: float) -> list[bytes]:
        self._priority = 0
        self._setpoint = None
        return self._note("notify", now_s)

    def _generic_location(self, data: bytes, now_s: float) -> list[bytes]:
        if data[0] == 8:
            self.poses.append((now_s, struct.unpack_from("<7f", data, 1)))
        elif data[0] == 3 and self.protocol < 12:
            self.supervisor.emergency = True
            self._note("emergency", now_s)
        return []

    def _supervise(self, data: bytes, now_s: float) -> list[bytes]:
        if self.protocol < 12:
            return []
        if data[0] == 1:
            self._note("arm" if data[1] else "disarm", now_s)
            done = False if self.refuse_arming and data[1] else self.supervisor.request(bool(data[1]))
            return [bytes((0x81, done, self.supervisor.armed))]
        if data[0] == 3:
            self.supervisor.emergency = True
            self._note("emergency", now_s)
        return []


LOG_TYPES = {"u8": 1, "u16": 2, "u32": 3, "i8": 4, "i16": 5, "i32": 6, "f": 7}
PARAM_TYPES = {"u8": 8, "u16": 9, "u32": 0xA, "i8": 0, "i16": 1, "i32": 2, "f": 6}
CODE = {"u8": "<B", "u16": "<H", "u32": "<I", "i8": "<b", "i16": "<h", "i32": "<i", "f": "<f"}
READ_ONLY = 0x40

LOGS = {
    **{f"stateEstimateZ.{name}": "i16" for name in ("x", "y", "z", "vx", "vy", "vz")},
    "stateEstimateZ.quat": "u32",
    **{f"stateEstimateZ.rate{name}": "i16" for name in ("Roll", "Pitch", "Yaw")},
    "supervisor.info": "u16",
    "pm.vbat": "f",
    "pm.vbatMV": "u16",
    "pm.state": "i8",
    "pm.batteryLevel": "u8",
    **{f"motor.m{number}": "u16" for number in range(1, 5)},
    **{f"kalman.varP{axis}": "f" for axis in "XYZ"},
}


@dataclass
class Param:
    """One parameter."""

    kind: str
    value: float
    read_only: bool = False


def params() -> dict[str, Param]:
    return {
        "stabilizer.estimator": Param("u8", 1),
        "stabilizer.controller": Param("u8", 1),
        **{f"kalman.initial{name}": Param("f", 0) for name in ("X", "Y", "Z", "Yaw")},
        "kalman.resetEstimation": Param("u8", 0),
        "locSrv.extPosStdDev": Param("f", 0.01),
        "locSrv.extQuatStdDev": Param("f", 4.5e-3),
        "deck.bcFlow2": Param("u8", 0, True),
        "deck.bcLighthouse4": Param("u8", 1, True),
        "deck.bcLoco": Param("u8", 0, True),
    }


@dataclass
class Toc:
    """Names and types by number."""

    entries: list[tuple[str, int]] = field(default_factory=list)

    def info(self) -> bytes:
        text = repr(self.entries).encode()
        return struct.pack("<BHI", 3, len(self.entries), zlib.crc32(text))

    def item(self, index: int) -> bytes:
        name, kind = self.entries[index]
        group, _, variable = name.partition(".")
        return struct.pack("<BHB", 2, index, kind) + f"{group}\0{variable}\0".encode()

    def name(self, index: int) -> str:
        return self.entries[index][0]


def log_toc() -> Toc:
    return Toc([(name, LOG_TYPES[kind]) for name, kind in LOGS.items()])


def param_toc(table: dict[str, Param]) -> Toc:
    return Toc([(name, PARAM_TYPES[p.kind] | (READ_ONLY if p.read_only else 0)) for name, p in table.items()])


def quaternion_bits(wxyz: tuple[float, float, float, float]) -> int:
    """Quaternion in 32 bits (firmware quatcompress.h): largest element's index, three of sign and 9 bits."""
    q = (wxyz[1], wxyz[2], wxyz[3], wxyz[0])
    largest = max(range(4), key=lambda i: abs(q[i]))
    bits = largest
    for i in range(4):
        if i != largest:
            negative = (q[i] < 0) != (q[largest] < 0)
            bits = bits << 10 | negative << 9 | int(511 * abs(q[i]) * 2**0.5 + 0.5)
    return bits
