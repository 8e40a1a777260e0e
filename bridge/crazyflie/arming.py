"""Requests to the firmware's supervisor to arm or to stop the motors; each is repeated until answered.

Motors-off consists of three packets: a stop set-point; a notice that no more set-points follow, without which
the supervisor locks after two seconds (firmware supervisor.c); and a disarming request, which also works in
flight. If a forced disarm has no effect, an emergency stop follows; it is latched until a restart.
"""

from __future__ import annotations

from dataclasses import dataclass

from bridge.crazyflie.packets import ArmReply, CrazyflieState, Info, Order, Packet

REPEAT_S = 0.05  # time between two repeats of a request, s: the period of two state packets
ARM_MAX_S = 0.6  # time-out of an arming request without an answer, s
KILL_UNSEEN_S = 0.2  # time without effect after which a forced disarm becomes an emergency stop, s
OFF_MAX_S = 1.0  # longest time that motors-off is repeated, s
NOTICES = 6  # number of notices sent after the motors are off, since packets may be lost
REFUSED = "the supervisor refused"
_OFF = (Order.STOP, Order.NOTIFY_STOP, Order.DISARM)


@dataclass(slots=True)
class _Request:
    since_s: float
    sent_s: float
    forced: bool = False
    refused: bool = False


class Arming:
    """Requests to the supervisor whose effect is not observed yet."""

    def __init__(self) -> None:
        self.armed = False  # whether a client of this bridge armed, and the firmware confirmed it
        self._arm: _Request | None = None
        self._off: _Request | None = None
        self._latched = False
        self._notices, self._notice_s = 0, 0.0
        self._arms_itself = False

    @property
    def arming(self) -> bool:
        return self._arm is not None

    @property
    def busy(self) -> bool:
        """Whether a packet must still be sent or an effect must still be observed."""
        return self._arm is not None or self._off is not None or self._notices > 0

    def ask(self, state: CrazyflieState, now_s: float) -> list[Packet]:
        """Start arming and return the packets; firmware that arms itself needs no packet."""
        self._off, self._notices = None, 0
        if state.info & Info.ARMED:
            self.armed = True
            return []
        self._arm, self._arms_itself = _Request(now_s, now_s), bool(state.info & Info.AUTO_ARM)
        return [Order.ARM]

    def reply(self, reply: ArmReply) -> str | None:
        """Return the reason of a refusal; while the firmware arms itself, its refusals are ignored."""
        if self._arm is None or reply.accepted:
            return None
        self._arm.refused = True
        if self._arms_itself:
            return None
        self._arm = None
        return REFUSED

    def off(self, now_s: float, *, forced: bool) -> list[Packet]:
        """Stop the motors now; a repeated request sends the packets again, in case they were lost."""
        self.armed, self._arm = False, None
        since_s = self._off.since_s if self._off is not None and self._off.forced else now_s
        self._off = _Request(since_s, now_s, forced or (self._off is not None and self._off.forced))
        return list(_OFF)

    def emergency(self, now_s: float) -> list[Packet]:
        packets = self.off(now_s, forced=True)
        self._latched = True
        return [Order.EMERGENCY_STOP, *packets]

    def forget(self, *, armed: bool) -> None:
        """Drop all open requests because the link is lost."""
        self.armed, self._arm, self._off, self._latched = armed, None, None, False
        self._notices = 0

    def step(self, state: CrazyflieState | None, now_s: float) -> tuple[list[Packet], str | None]:
        """Return the packets to repeat, and a text if a request has failed."""
        if self._arm is not None:
            return self._step_arm(self._arm, state, now_s)
        if self._off is not None:
            return self._step_off(self._off, state, now_s)
        if self._notices and now_s - self._notice_s >= REPEAT_S - 1e-9:
            self._notices, self._notice_s = self._notices - 1, now_s
            return [Order.NOTIFY_STOP], None
        return [], None

    def _step_arm(
        self, request: _Request, state: CrazyflieState | None, now_s: float
    ) -> tuple[list[Packet], str | None]:
        if state is not None and state.at_s > request.since_s and state.info & Info.ARMED:
            self.armed, self._arm = True, None
            return [], None
        if now_s - request.since_s > ARM_MAX_S:
            self._arm = None
            return [], REFUSED if request.refused else "the supervisor did not answer"
        return self._repeat(request, (Order.ARM,), now_s), None

    def _step_off(
        self, request: _Request, state: CrazyflieState | None, now_s: float
    ) -> tuple[list[Packet], str | None]:
        after_s = now_s - request.since_s
        fresh = state is not None and state.at_s > request.since_s + REPEAT_S  # measured after the request
        if fresh and state is not None and not state.info & Info.FLYING:
            self._off, self._latched = None, False
            # If the notice is lost, the supervisor reports a lost link two seconds later.
            self._notices, self._notice_s = NOTICES, now_s
            return [Order.NOTIFY_STOP], None
        if after_s > OFF_MAX_S:
            self._off, self._latched = None, False
            return [], "Motors off was not confirmed" if request.forced else None
        if request.forced and after_s > KILL_UNSEEN_S and not self._latched:
            self._latched = True
            return [Order.EMERGENCY_STOP], "Disarming had no effect: emergency stop, restart needed"
        orders = (Order.EMERGENCY_STOP, *_OFF) if self._latched else _OFF
        return self._repeat(request, orders, now_s), None

    @staticmethod
    def _repeat(request: _Request, orders: tuple[Packet, ...], now_s: float) -> list[Packet]:
        if now_s - request.sent_s < REPEAT_S - 1e-9:
            return []
        request.sent_s = now_s
        return list(orders)
