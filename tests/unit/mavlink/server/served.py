"""Common interface of the two vehicles that use the MAVLink server, for tests that run with both."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from bridge.mavlink.server.server import Server
from tests.crazyflie_firmware.bench import Bench

NAN = math.nan
NAN7 = (NAN,) * 7
COMPANION, STRANGER, GROUND_STATION, MAVSDK = (1, 191), (7, 190), (255, 190), (245, 190)
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)  # values of MAV_RESULT
OFFBOARD, HOLD, LAND = (1.0, 6.0, 0.0), (1.0, 4.0, 3.0), (1.0, 4.0, 6.0)
KILL = (0.0, 21196.0)  # parameters of a forced disarm
TICK_S = 0.01


def as_long(number: int, params: tuple[float, ...], target: tuple[int, int] = (1, 1)):
    """Return a command as COMMAND_LONG; missing parameters are NaN."""
    return mav.MAVLink_command_long_message(*target, number, 0, *params, *NAN7[len(params) :])


def as_int(number: int, params: tuple[float, ...], frame: int = 0):
    p1, p2, p3, p4, p5, p6, p7 = (*params, *NAN7[len(params) :])
    x, y = (2**31 - 1 if math.isnan(p) else round(p * 1e7) for p in (p5, p6))
    return mav.MAVLink_command_int_message(1, 1, frame, number, 0, 0, p1, p2, p3, p4, x, y, p7)


def setpoint(n=0.0, e=0.0, d=0.0, *, frame=1, mask=2503, yaw=0.0, rate=0.0, target=(1, 1)):
    zeros = (0.0, 0.0, 0.0)
    return mav.MAVLink_set_position_target_local_ned_message(
        0, *target, frame, mask, *zeros, n, e, d, *zeros, yaw, rate
    )


class Served:
    """A vehicle that a MAVLink server controls.

    A subclass has ``now_s``; ``velocity_enu_m_s``: last velocity passed to the vehicle; ``tick``: runs 10 ms;
    ``fly``: takes off and holds; ``homed``: waits, disarmed, until the vehicle has a home position.
    """

    server: Server
    telemetry: list  # messages to all clients since the start
    silence_s: float  # time without set-points, s, after which another client may take control

    def state(self) -> list[object]:
        """Return the values of the vehicle that commands can change; intervals in us."""
        intervals_us = [self.server.streams.interval_us(i) for i in (30, 32, 1)]
        return [self.mode, self.armed, intervals_us, self.server.vehicle.home_enu_m]

    @property
    def mode(self) -> FlightMode:
        return self.server.vehicle.mode

    @property
    def armed(self) -> bool:
        return self.server.vehicle.armed

    def handle(self, message, sender=COMPANION) -> list:
        return self.server.handle(message, sender, self.now_s)

    def command(self, number: int, *params: float, sender=COMPANION, target=(1, 1)) -> int | None:
        """Send a command; return its MAV_RESULT, or None without a reply."""
        replies = self.handle(as_long(number, params, target), sender)
        acks = [r for r in replies if r.get_type() == "COMMAND_ACK"]
        assert all((a.target_system, a.target_component, a.command) == (*sender[:2], number) for a in acks)
        return acks[0].result if acks else None

    def run(self, duration_s: float, velocity_ned=None, sender=COMPANION) -> None:
        for _ in range(round(duration_s / TICK_S)):
            if velocity_ned is not None:
                self.handle(setpoint(*velocity_ned), sender)
            self.tick()

    def offboard(self) -> Served:
        self.fly()
        self.run(0.1, (0.0, 0.0, 0.0))
        assert self.command(176, *OFFBOARD) == ACCEPTED
        self.run(0.1, (0.1, 0.0, 0.0))
        self.texts()
        return self

    def forget(self) -> None:
        self.telemetry.clear()

    def texts(self) -> list[str]:
        self.tick()
        return [text.text for text in self.server.take_texts()]

    def seen(self, message_id: int) -> list:
        return [m for m in self.telemetry if m.get_msgId() == message_id]


class Bridged(Served):
    """The Crazyflie bridge, connected to the firmware model without cflib."""

    silence_s = 1.0

    def __init__(self) -> None:
        self.bench = Bench().ready()
        self.server, self.telemetry = self.bench.node, []

    @property
    def now_s(self) -> float:
        return self.bench.now_s

    @property
    def velocity_enu_m_s(self) -> tuple[float, float, float]:
        return self.bench.velocities()[-1][1].velocity_enu_m_s

    def tick(self) -> None:
        self.bench.step()
        self.telemetry += [message for _, message in self.bench.out]
        self.bench.out.clear()

    def fly(self) -> Bridged:
        self.bench.hover()
        self.bench.out.clear()
        return self

    def homed(self) -> Bridged:
        self.bench.hover().command(21)
        self.bench.until(lambda: not self.bench.vehicle.armed).run(1.0)
        return self

    def forget(self) -> None:
        super().forget()
        self.bench.out.clear()
        self.bench.firmware.setpoints.clear()
        self.bench.sent[:] = self.bench.velocities()[-1:]
