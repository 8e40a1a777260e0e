"""Packets for the Crazyflie, and their queue: urgent packets first; old velocities are dropped."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from bridge.frames import Quat
from flightstack.core.types import Vec3


class Velocity(NamedTuple):
    """A velocity set-point; its packet is sent immediately or dropped."""

    velocity_enu_m_s: Vec3
    yaw_rate_rad_s: float  # yaw rate, counter-clockwise


class Pose(NamedTuple):
    position_enu_m: Vec3
    quaternion: Quat  # attitude of FLU in ENU, in the order w, x, y, z


class Order(Enum):
    STOP = "stop set-point: motors off"
    NOTIFY_STOP = "no more set-points will come"
    ARM = "arm"
    DISARM = "disarm"
    EMERGENCY_STOP = "emergency stop, latched until restart"
    RECOVER = "crash recovery"
    RECONNECT = "close the link and open it again"


class SetParam(NamedTuple):
    name: str
    value: float


Packet = Velocity | Pose | Order | SetParam

ORDERS_MAX = 64
VELOCITY_AGE_MAX_S = 0.1  # maximum age of a velocity, s; without a velocity the firmware's watchdog acts
_URGENT = frozenset({Order.EMERGENCY_STOP, Order.STOP, Order.DISARM})


class Outbox:
    """Thread-safe queue of packets; ``put`` never blocks."""

    def __init__(self) -> None:
        self.late = 0  # number of velocities dropped because of their age
        self.lost = 0  # number of orders dropped from a full queue
        self._ready = threading.Condition()
        self._orders: deque[Order | SetParam] = deque()
        self._velocity: tuple[Velocity, float] | None = None
        self._pose: Pose | None = None
        self._woken = False

    def put(self, packet: Packet, now_s: float) -> None:
        """Add a packet; motors-off deletes the queued velocity."""
        with self._ready:
            if isinstance(packet, Velocity):
                self._velocity = (packet, now_s)
            elif isinstance(packet, Pose):
                self._pose = packet
            else:
                self._add_order(packet)
            self._ready.notify()

    def _add_order(self, order: Order | SetParam) -> None:
        urgent = order in _URGENT
        if urgent:
            self._velocity = None
        if len(self._orders) >= ORDERS_MAX:
            self.lost += 1
            if not urgent:
                return
            self._orders.pop()
        if order is Order.EMERGENCY_STOP:
            self._orders.appendleft(order)
        else:
            self._orders.append(order)

    def get(self, timeout_s: float, clock: Callable[[], float]) -> Packet | None:
        """Return the next packet; None: no packet arrived within the time-out."""
        with self._ready:
            self._ready.wait_for(
                lambda: self._woken or self._orders or self._velocity or self._pose, timeout_s
            )
            self._woken = False
            if self._orders:
                return self._orders.popleft()
            if self._velocity is not None:
                (velocity, since_s), self._velocity = self._velocity, None
                if clock() - since_s <= VELOCITY_AGE_MAX_S:
                    return velocity
                self.late += 1
            pose, self._pose = self._pose, None
            return pose

    def clear(self) -> None:
        with self._ready:
            self._orders.clear()
            self._velocity = self._pose = None

    def wake(self) -> None:
        with self._ready:
            self._woken = True
            self._ready.notify()
