"""Firmware parameters that the bridge writes at the connection and, if requested, restores at the end.

In flight the firmware's Kalman filter uses only the accelerometer's body z axis, so it needs the rotor drag:
with ``kalman.dragB_*`` at the default 0 its velocity is 16 % too high (measured on firmware 2026.08, drag
0.46 1/s), and at a commanded 0.30 m/s the vehicle flies 0.24 m/s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from bridge.crazyflie.condition import ESTIMATOR, KALMAN
from bridge.crazyflie.types import SetParam
from flightstack.core.types import Vec3

DRAG = ("kalman.dragB_x", "kalman.dragB_y", "kalman.dragB_z")  # rotor drag along the body axes, 1/s
UNKNOWN_DRAG = "Firmware has no kalman.dragB_x: its velocity is too high in flight"
ECHO_MAX_S = 1.0  # time without an echo after which a restored parameter counts as lost, s
_SAME = 1e-6  # relative tolerance; the firmware's floats have 24 bits


class Settings:
    """Parameters to write, and their previous values."""

    def __init__(self, drag_1_s: Vec3 | None, *, restore: bool) -> None:
        """``drag_1_s`` None leaves the firmware's value; ``restore`` writes the old values at the end."""
        self._wanted = {ESTIMATOR: float(KALMAN)}
        if drag_1_s is not None:
            self._wanted.update(zip(DRAG, drag_1_s, strict=True))
        self._restore = restore
        self._found: dict[str, float] = {}  # values before the first write
        self._open: set[str] = set()  # restored parameters whose echo has not arrived yet
        self._left_s = math.inf

    def connected(self, params: Mapping[str, str]) -> tuple[list[SetParam], str | None]:
        """Return the packets to write to a firmware with these parameters, and a warning."""
        packets: list[SetParam] = []
        for name, value in self._wanted.items():
            if name in params and not math.isclose(float(params[name]), value, rel_tol=_SAME, abs_tol=_SAME):
                self._found.setdefault(name, float(params[name]))
                packets.append(SetParam(name, value))
        known = not self._wanted.keys() & set(DRAG) or DRAG[0] in params
        return packets, None if known else UNKNOWN_DRAG

    def leave(self, now_s: float) -> list[SetParam]:
        """Return the packets that restore the previous values; only once."""
        if not self._restore or self._left_s < math.inf:
            return []
        self._left_s, self._open = now_s, set(self._found)
        return [SetParam(name, value) for name, value in self._found.items()]

    def echoed(self, name: str) -> None:
        self._open.discard(name)

    def busy(self, now_s: float) -> bool:
        return self._restore and bool(self._found) and now_s - self._left_s <= ECHO_MAX_S and bool(self._open)
