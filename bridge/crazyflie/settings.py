"""Firmware parameters that the bridge writes when it connects, and restores when it ends, if requested.

In flight the firmware's Kalman filter uses the accelerometer's body z alone, so it must know the rotor drag:
with ``kalman.dragB_*`` at 0, their default, its velocity is 16 % too high (measured on firmware 2026.08; drag
0.46 1/s), and a vehicle that is commanded 0.30 m/s flies 0.24.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from bridge.crazyflie.condition import ESTIMATOR, KALMAN
from bridge.crazyflie.types import SetParam
from flightstack.core.types import Vec3

DRAG = ("kalman.dragB_x", "kalman.dragB_y", "kalman.dragB_z")  # body axes, 1/s
UNKNOWN_DRAG = "Firmware has no kalman.dragB_x: its velocity is too high in flight"
ECHO_MAX_S = 1.0  # s until a restored parameter counts as lost
_SAME = 1e-6  # share; the firmware's floats have 24 bits


class Settings:
    """What to write, and what was there before."""

    def __init__(self, drag_1_s: Vec3 | None, *, restore: bool) -> None:
        """``drag_1_s`` None leaves the firmware's; ``restore`` writes the old values back at the end."""
        self._wanted = {ESTIMATOR: float(KALMAN)}
        if drag_1_s is not None:
            self._wanted.update(zip(DRAG, drag_1_s, strict=True))
        self._restore = restore
        self._found: dict[str, float] = {}  # before the first write
        self._open: set[str] = set()  # restored, echo not received yet
        self._left_s = math.inf

    def connected(self, params: Mapping[str, str]) -> tuple[list[SetParam], str | None]:
        """Packets for a firmware with these parameters, and a warning."""
        packets: list[SetParam] = []
        for name, value in self._wanted.items():
            if name in params and not math.isclose(float(params[name]), value, rel_tol=_SAME, abs_tol=_SAME):
                self._found.setdefault(name, float(params[name]))
                packets.append(SetParam(name, value))
        known = not self._wanted.keys() & set(DRAG) or DRAG[0] in params
        return packets, None if known else UNKNOWN_DRAG

    def leave(self, now_s: float) -> list[SetParam]:
        """Packets that restore what was found; once."""
        if not self._restore or self._left_s < math.inf:
            return []
        self._left_s, self._open = now_s, set(self._found)
        return [SetParam(name, value) for name, value in self._found.items()]

    def echoed(self, name: str) -> None:
        """Note the firmware's answer to a write."""
        self._open.discard(name)

    def busy(self, now_s: float) -> bool:
        """Whether something is still to be restored."""
        return self._restore and bool(self._found) and now_s - self._left_s <= ECHO_MAX_S and bool(self._open)
