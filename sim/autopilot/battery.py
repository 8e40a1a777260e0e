"""Charge of the battery as the autopilot knows it: from the voltage, corrected for the load.

After PX4 battery.cpp: the cell's voltage, plus what the load takes at this throttle, between the voltages of
an empty and a full cell. Both are smoothed, or every climb would look like an empty battery.
"""

from __future__ import annotations

import math
from enum import IntEnum

from sim.autopilot.parameters import Parameters

_SMOOTH_S = 1.0  # s, time constant
_BETTER = 0.03  # of charge above a threshold until the level gets better again


class Charge(IntEnum):
    """How bad it is; the values are those of MAV_BATTERY_CHARGE_STATE."""

    OK = 1
    LOW = 2
    CRITICAL = 3
    EMERGENCY = 4


class BatteryGauge:
    """Charge left and its level; while armed the level only gets worse, as in PX4 (failsafe.cpp).

    Attributes:
        remaining: 0 to 1.
        level: against BAT_LOW_THR, BAT_CRIT_THR and BAT_EMERGEN_THR.
    """

    def __init__(self, parameters: Parameters, voltage_v: float, throttle: float) -> None:
        self._parameters = parameters
        self._voltage_v, self._throttle = voltage_v, throttle
        self.remaining, self.level = 1.0, Charge.OK
        self.step(voltage_v, throttle, 0.0, armed=False)

    def step(self, voltage_v: float, throttle: float, dt_s: float, *, armed: bool) -> Charge | None:
        """Take a measurement.

        Args:
            voltage_v: of the one cell, under load.
            throttle: mean of the motors' commands, 0 to 1.
            dt_s: time since the last one.
            armed: whether the level may only get worse.

        Returns:
            The level when it has just become worse.
        """
        share = 1.0 - math.exp(-dt_s / _SMOOTH_S)
        self._voltage_v += share * (voltage_v - self._voltage_v)
        self._throttle += share * (throttle - self._throttle)
        p = self._parameters
        empty_v, full_v = p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"]
        rest_v = self._voltage_v + p["BAT1_V_LOAD_DROP"] * self._throttle
        self.remaining = min(max((rest_v - empty_v) / max(full_v - empty_v, 0.01), 0.0), 1.0)
        before = self.level
        better = before if armed else self._judge(self.remaining - _BETTER)
        self.level = max(self._judge(self.remaining), min(before, better))
        return self.level if self.level > before else None

    def _judge(self, remaining: float) -> Charge:
        for level, name in _THRESHOLDS:
            if remaining < self._parameters[name]:
                return level
        return Charge.OK


_THRESHOLDS = (
    (Charge.EMERGENCY, "BAT_EMERGEN_THR"),
    (Charge.CRITICAL, "BAT_CRIT_THR"),
    (Charge.LOW, "BAT_LOW_THR"),
)
