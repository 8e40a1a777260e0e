"""Thrust reserve of the vehicle, computed from the battery voltage, and the use of this reserve.

The reserve is the maximum thrust divided by the weight. Thrust is proportional to (throttle x voltage)^p, so
the throttle t in hover rises when the voltage falls. At constant voltage the reserve is

    r = (throttle_max / t)^p,    t = hover_throttle hover_voltage_v / voltage

But the current is proportional to the thrust to the power 1.5. The current lowers the voltage, by sag_v from
rest to hover. To first order the fraction 1 / (1 + 1.5 p sag_v / voltage) of r - 1 remains.

If the firmware compensates the battery voltage, a fixed motor voltage limits the thrust command. The maximum
throttle is then the lower one of throttle_max and motor_voltage_max_v / voltage.

Recorded Crazyflies 2.1 that carry markers hover at 0.78 of full PWM at 3.7 V and at 0.90 at 3.1 V; p is 1.5.
The throttles of the motors span 9 %, so the highest one saturates at a mean throttle of about 0.95.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, span

GRAVITY_M_S2 = 9.81
LEAST_M_S2 = 0.1  # minimum of the acceleration limit, m/s^2, so that the velocity can always change


@dataclass(frozen=True, slots=True)
class Reserve:
    """Battery, and the thrust that the battery allows; without this table the battery sets no limits."""

    hover_throttle: Annotated[float, span(0.05, 1.0)]  # mean throttle of the motors in hover
    hover_voltage_v: Annotated[float, span(1.0, 100.0)]  # voltage in hover at `hover_throttle`
    lowest_voltage_v: Annotated[float, span(1.0, 100.0)]  # minimum voltage in flight that is certified
    sag_v: Annotated[float, span(0.0, 20.0)] = 0.0  # voltage drop from rest to hover
    start_margin_v: Annotated[float, span(0.0, 20.0)] = 0.05  # margin above lowest_voltage_v before a landing
    throttle_max: Annotated[float, span(0.1, 1.0)] = 0.95  # maximum mean throttle; above it a motor saturates
    # mean motor voltage at the maximum thrust command, if the firmware compensates the battery
    motor_voltage_max_v: Annotated[float, span(0.1, 100.0)] | None = None
    thrust_exponent: Annotated[float, span(0.5, 3.0)] = 1.5  # exponent p of the thrust
    share: Annotated[float, span(0.1, 1.0)] = 0.5  # part of the reserve for commands; the rest is for wind
    smoothing_s: Annotated[float, span(0.2, 20.0)] = 1.0  # time constant of the reserve estimate in flight

    def __post_init__(self) -> None:
        least = self.at(self.lowest_voltage_v)
        if not least > 1.0:
            lift_v = self.voltage_v(1.0)
            more = f"more than {lift_v:.3g}" if lift_v < math.inf else "a higher motor_voltage_max_v"
            raise ConfigError(
                f"lowest_voltage_v: found {self.lowest_voltage_v:g}; there the vehicle does not lift its "
                f"weight (reserve {least:.3g}); allowed is {more}, or less hover_throttle"
            )

    def at(self, voltage_v: float) -> float:
        """Return the reserve at a voltage in flight, from ``hover_throttle`` and ``hover_voltage_v``."""
        effort = self.effort(self.hover_throttle * self.hover_voltage_v / voltage_v)
        return left(effort, self.sags(voltage_v), self.most(voltage_v))

    def effort(self, throttle: float) -> float:
        """Return the thrust at a throttle divided by the thrust at ``throttle_max``, at equal voltage."""
        return math.pow(throttle / self.throttle_max, self.thrust_exponent)

    def sags(self, voltage_v: float) -> float:
        """Return the loss term of the voltage sag, 1.5 p sag_v / voltage (see the module's docstring)."""
        return 1.5 * self.thrust_exponent * self.sag_v / voltage_v

    def most(self, voltage_v: float) -> float:
        """Return the effort at which the thrust command saturates at a voltage; inf: no saturation."""
        if self.motor_voltage_max_v is None:
            return math.inf
        return self.effort(self.motor_voltage_max_v / voltage_v)

    def voltage_v(self, reserve: float) -> float:
        """Return the lowest voltage in flight that gives this reserve; inf: no voltage gives it."""
        hover_v, most_v = self.hover_throttle * self.hover_voltage_v, self.motor_voltage_max_v
        if most_v is not None and math.pow(most_v / hover_v, self.thrust_exponent) < reserve:
            return math.inf
        least_v = hover_v / self.throttle_max
        voltage_v = least_v
        for _ in range(30):  # the iteration converges: each change is a fraction of the previous one
            sags = self.sags(voltage_v)
            voltage_v = least_v * math.pow(1.0 + (reserve - 1.0) * (1.0 + sags), 1.0 / self.thrust_exponent)
        return voltage_v

    @property
    def start_voltage_v(self) -> float:
        """Minimum voltage in flight at which the start of a landing is allowed, V."""
        return self.lowest_voltage_v + self.start_margin_v


def left(effort: float, sags: float, most: float) -> float:
    """Return the reserve for the effort of hover; more thrust lowers the voltage (``Reserve.sags``)."""
    return min(1.0 + (1.0 / effort - 1.0) / (1.0 + sags), most / effort)


def up_m_s2(reserve: float, share: float) -> float:
    """Return the limit of the commanded upward acceleration, m/s^2."""
    return max(LEAST_M_S2, share * (reserve - 1.0) * GRAVITY_M_S2)


def level_m_s2(reserve: float, share: float) -> float:
    """Return the limit of the commanded acceleration on x and y, m/s^2; tilt uses the remaining thrust."""
    lift = reserve / (1.0 + share * (reserve - 1.0)) if reserve > 1.0 else 1.0
    return max(LEAST_M_S2, GRAVITY_M_S2 * math.sqrt(0.5 * (lift * lift - 1.0)))
