"""Decodes the Crazyflie's log packets: one packet holds a whole state, so its parts fit together.

``stateEstimateZ`` (firmware stabilizer.c) carries millimetres, millimetres a second, a quaternion in 32 bits
and milliradians a second; with supervisor bits and voltage that makes 26 bytes, the most a packet holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from bridge.crazyflie.types import CrazyflieState, Health, HealthBlock, Info, Power, StateBlock
from bridge.frames import Quat

STATE_PERIOD_MS = 10
STATE_VARIABLES: tuple[str, ...] = (
    *(f"stateEstimateZ.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "quat")),
    *(f"stateEstimateZ.rate{axis}" for axis in ("Roll", "Pitch", "Yaw")),
    "supervisor.info",
    "pm.vbatMV",
)
HEALTH_PERIOD_MS = 100
HEALTH_VARIABLES: tuple[str, ...] = (
    *(f"kalman.varP{axis}" for axis in "XYZ"), "pm.state", "pm.batteryLevel",
    *(f"motor.m{number}" for number in (1, 2, 3, 4)),
)  # fmt: skip
FETCHED_AS: Mapping[str, str] = dict.fromkeys(HEALTH_VARIABLES[-4:], "uint16_t")  # older firmware has 32 bits
_PWM_MAX = 65535.0
LATE_MAX_S = 0.2  # s; a packet that was held up longer is not the present any more
_WRAP_MS = 1 << 24
_REBOOT_MS = 1000  # a clock that falls back further is a restart, less is a packet out of order
_DRIFT = 1e-4  # of two crystals, generous: the shortest delay seen is forgotten this fast
_MAGNITUDE = (1 << 9) - 1  # of a quaternion's element, besides a sign bit (quatcompress.h)


class BootClock:
    """The firmware's 24-bit milliseconds as a clock that goes on, and how late a packet is.

    The packet with the shortest way sets the zero of lateness; a longer way is lateness.
    """

    def __init__(self) -> None:
        self._last_ms: int | None = None
        self._zero_s = math.inf  # shortest of arrival minus firmware time
        self._zero_at_s = 0.0

    @property
    def running(self) -> bool:
        """Whether a packet has been seen."""
        return self._last_ms is not None

    def take(self, time_ms: int, at_s: float) -> tuple[int, float] | None:
        """Unwrapped milliseconds and lateness in seconds; None: not newer than the last.

        ``time_ms`` has 24 bits.
        """
        if self._last_ms is None:
            boot_ms = time_ms
        else:
            step_ms = (time_ms - self._last_ms + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
            if -_REBOOT_MS < step_ms <= 0:
                return None
            boot_ms = self._last_ms + step_ms
            if step_ms <= -_REBOOT_MS:  # restarted
                boot_ms, self._zero_s = time_ms, math.inf
        self._last_ms = boot_ms
        way_s = at_s - boot_ms / 1000.0
        self._zero_s = min(way_s, self._zero_s + _DRIFT * (at_s - self._zero_at_s))
        self._zero_at_s = at_s
        return boot_ms, way_s - self._zero_s

    def now_ns(self, now_s: float) -> int:
        """Firmware clock at a bridge time, ns, for TIMESYNC."""
        return max(1, round((now_s - self._zero_s) * 1e9))


def decode_state(block: StateBlock, boot_ms: int, at_s: float) -> CrazyflieState:
    """Turn a packet into a state.

    The packet holds every variable of ``STATE_VARIABLES``; ``boot_ms`` is unwrapped time, ``at_s`` the
    arrival.

    Raises:
        KeyError: a variable is missing.
    """
    v = block.values
    x, y, z, vx, vy, vz = (v[name] / 1000.0 for name in STATE_VARIABLES[:6])
    roll, pitch, yaw = (v[f"stateEstimateZ.rate{axis}"] / 1000.0 for axis in ("Roll", "Pitch", "Yaw"))
    return CrazyflieState(
        at_s,
        boot_ms,
        (x, y, z),
        (vx, vy, vz),
        decompress_quaternion(v["stateEstimateZ.quat"]),
        (roll, -pitch, yaw),  # the firmware counts pitch the other way round (stabilizer.c, compressState)
        Info(v["supervisor.info"] & sum(Info)),
        v["pm.vbatMV"] / 1000.0,
    )


def decode_health(block: HealthBlock, at_s: float) -> Health:
    """Turn a packet into what it says of estimate, battery and motors.

    Raises:
        KeyError: a variable is missing.
        ValueError: ``pm.state`` is none of the known ones.
    """
    v: Mapping[str, float] = block.values
    variance = (v["kalman.varPX"], v["kalman.varPY"], v["kalman.varPZ"])
    throttle = sum(v[name] for name in HEALTH_VARIABLES[-4:]) / (4.0 * _PWM_MAX)
    return Health(at_s, variance, Power(int(v["pm.state"])), int(v["pm.batteryLevel"]), throttle)


def decompress_quaternion(packed: int) -> Quat:
    """Unit quaternion w, x, y, z of 32 bits: the index of the largest element, the other three as ten bits.

    The largest is positive and follows from the norm; order on the wire is x, y, z, w (quatcompress.h).
    """
    largest = packed >> 30
    xyzw = [0.0] * 4
    for i in (3, 2, 1, 0):
        if i == largest:
            continue
        magnitude = math.sqrt(0.5) * (packed & _MAGNITUDE) / _MAGNITUDE
        xyzw[i] = -magnitude if packed & (_MAGNITUDE + 1) else magnitude
        packed >>= 10
    xyzw[largest] = math.sqrt(max(0.0, 1.0 - sum(e * e for e in xyzw)))
    return (xyzw[3], xyzw[0], xyzw[1], xyzw[2])
