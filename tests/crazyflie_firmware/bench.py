"""Runs bridge node and firmware model on one simulated clock, with real packets but without cflib, sockets
or threads."""

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.crazyflie.node import Node
from bridge.crazyflie.packets import (
    BLOCKS,
    ArmReply,
    Connected,
    LogPacket,
    Lost,
    Order,
    Packet,
    ParamValue,
    SetParam,
    Velocity,
)
from bridge.crazyflie.rules import CrazyflieOptions
from bridge.ros2.cdr import Pose
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.tables import CODE, LOGS

STEP_S = 0.01
CLIENT, OTHER, GROUND = (1, 191), (7, 190), (255, 190)
NAN = float("nan")
_HEADS = {
    Order.STOP: b"\x7c\x00",
    Order.NOTIFY_STOP: b"\x7d\x00" + bytes(4),
    Order.ARM: b"\x9d\x01\x01",
    Order.DISARM: b"\x9d\x01\x00",
    Order.RECOVER: b"\x9d\x02",
    Order.EMERGENCY_STOP: b"\x9d\x03",
}


class Bench:
    """Advances bridge and firmware in steps of 10 ms; a client sends heartbeats and optional set-points.

    ``mute``: packets from the firmware are lost; ``deaf``: packets to the firmware are lost.
    """

    def __init__(self, firmware: Firmware | None = None, drag_1_s=None, **options) -> None:
        self.firmware = firmware or Firmware()
        self.node = Node(CrazyflieOptions(uri="bench", **options), drag_1_s)
        self.now_s = 0.0
        self.sent: list[tuple[float, Packet]] = []  # (time, packet) of all packets that the bridge sent
        self.out: list[tuple[float, object]] = []  # (time, message) of all telemetry that the bridge sent
        self.replies: list[object] = []
        self.mute = self.deaf = self.client_gone = self.disarm_lost = False
        self.stream: tuple[float, float, float] | None = None  # velocity that the client streams, m/s NED
        self.connect()

    @property
    def vehicle(self):
        return self.node.vehicle

    @property
    def texts(self) -> list[str]:
        """Texts of all received STATUSTEXT messages; long texts are reassembled."""
        said = ""
        for _, m in self.out:
            if m.get_type() == "STATUSTEXT":
                said += m.text + ("" if m.id and len(m.text) == 50 else "\n")
        return said.splitlines()

    def connect(self) -> None:
        self.firmware.packet(b"\x5d\x05", self.now_s)  # deletes old log blocks, as after a connection
        params = {name: f"{p.value:g}" for name, p in self.firmware.params.items()}
        self._take(Connected(self.firmware.protocol, params))
        self._ask_logs()

    def _ask_logs(self) -> None:
        self._asked_s = self.now_s
        for number, (_, period_ms, names) in enumerate(BLOCKS, 1):
            ids = [bytes((0, i & 0xFF, i >> 8)) for i in (list(LOGS).index(n) for n in names)]
            head = bytes((number,))
            self.firmware.packet(b"\x5d\x06" + head + b"".join(ids[:9]), self.now_s)
            if ids[9:]:
                self.firmware.packet(b"\x5d\x07" + head + b"".join(ids[9:]), self.now_s)
            self.firmware.packet(b"\x5d\x03" + head + bytes((period_ms // 10,)), self.now_s)

    def lose(self, reason: str = "Too many packets lost") -> None:
        self._take(Lost(reason))

    def run(self, seconds: float):
        for _ in range(round(seconds / STEP_S)):
            self.step()
        return self

    def until(self, done, limit_s: float = 20.0):
        end_s = self.now_s + limit_s
        while not done():
            assert self.now_s < end_s, "did not come"
            self.step()
        return self

    def step(self) -> None:
        self.now_s += STEP_S
        if not self.deaf:
            self.firmware.packet(b"\xff", self.now_s)  # null packet, which keeps the link alive
        for raw in self.firmware.step(self.now_s):
            self._log(raw)
        if not (self.firmware._blocks or self.deaf or self.now_s - self._asked_s < 1.0):
            self._ask_logs()  # as the bridge's link does, repeat a request that got no data
        beat = mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        if not self.client_gone and round(self.now_s / STEP_S) % 50 == 0:
            self.node.handle(beat, CLIENT, self.now_s)
        if self.stream is not None:
            self.setpoint(self.stream)
        messages, replies = self.node.step(self.now_s)
        self.out += [(self.now_s, m) for m in messages]
        self.replies += [r.message for r in replies]
        self._send()

    def setpoint(self, ned=(0.0, 0.0, 0.0), sender=CLIENT, mask=2503, frame=1, yaw=math.pi / 2, rate=0.0):
        zeros = (0.0, 0.0, 0.0)
        message = mav.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, frame, mask, *zeros, *ned, *zeros, yaw, rate
        )
        self.node.handle(message, sender, self.now_s)

    def command(self, number: int, *params: float, sender=CLIENT, system: int = 1):
        values = [*params, *[NAN] * (7 - len(params))]
        message = mav.MAVLink_command_long_message(system, 1, number, 0, *values)
        answers = self.node.handle(message, sender, self.now_s)
        self._send()
        return answers

    def result(self, number: int, *params: float, sender=CLIENT) -> int:
        return self.command(number, *params, sender=sender)[0].result

    def ready(self):
        return self.until(lambda: not self.vehicle.problems(self.now_s))

    def armed(self):
        self.ready().command(400, 1.0)
        return self.until(lambda: self.vehicle.armed)

    def hover(self):
        self.armed().command(22)
        return self.until(lambda: self.vehicle.mode.value == "hold").run(1.0)

    def offboard(self, ned=(0.0, 0.0, 0.0)):
        self.hover().stream = ned
        self.run(0.1)
        assert self.result(176, 1.0, 6.0) == 0
        return self

    def last(self, kind: str):
        return next(m for _, m in reversed(self.out) if m.get_type() == kind)

    def times(self, kind: str) -> list[float]:
        return [t for t, m in self.out if m.get_type() == kind]

    def orders(self, order: Order) -> list[float]:
        return [t for t, p in self.sent if p is order]

    def velocities(self) -> list[tuple[float, Velocity]]:
        return [(t, p) for t, p in self.sent if isinstance(p, Velocity)]

    def _take(self, event) -> None:
        self.node.take(event, self.now_s)
        self._send()

    def _log(self, raw: bytes) -> None:
        if self.mute:
            return
        number, time_ms, body = raw[1], int.from_bytes(raw[2:5], "little"), raw[5:]
        names = self.firmware._blocks[number].names
        values = struct.unpack("<" + "".join(CODE[LOGS[n]][1] for n in names), body)
        pairs = dict(zip(names, values, strict=True))
        self._take(LogPacket(BLOCKS[number - 1].name, time_ms, pairs))

    def _send(self) -> None:
        for packet in self.vehicle.take_packets():
            self.sent.append((self.now_s, packet))
            if self.deaf or (packet is Order.DISARM and self.disarm_lost):
                continue
            if isinstance(packet, SetParam):
                self._write(packet)
                continue
            raw = _raw(packet)
            for answer in self.firmware.packet(raw, self.now_s) if raw else ():
                if answer[:2] == b"\x9d\x81" and not self.mute:
                    self._take(ArmReply(bool(answer[2]), bool(answer[3])))

    def _write(self, packet: SetParam) -> None:
        known = packet.name in self.firmware.params
        if known:
            self.firmware.params[packet.name].value = packet.value
            self.firmware.written()
        self._take(ParamValue(packet.name, f"{packet.value:g}" if known else None))


def _raw(packet: Packet) -> bytes | None:
    if isinstance(packet, Velocity):
        return b"\x7c\x08" + struct.pack("<4f", *packet.velocity_enu_m_s, math.degrees(packet.yaw_rate_rad_s))
    if isinstance(packet, Pose):
        w, x, y, z = packet.orientation_wxyz
        return b"\x6d\x08" + struct.pack("<7f", *packet.position_m, x, y, z, w)
    return _HEADS.get(packet)
