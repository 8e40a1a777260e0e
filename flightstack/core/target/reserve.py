"""Estimate of the thrust reserve in flight; the reserve limits accelerations and decides whether to land.

docs/how_it_works/robust_filter.md, *The thrust reserve*, derives the estimate. It uses the throttle in flight
or, without a throttle, the voltage. Without data the lowest reserve for which the certificate holds is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from flightstack.core.memory import ReserveMemory
from flightstack.core.parameters.reserve import GRAVITY_M_S2, Reserve, left, level_m_s2, up_m_s2
from flightstack.core.types import Charge, Landed, Power, Vec3, VehicleStatus

# lower limit of the ratio of averaged lift to weight in the estimate; a vehicle with less lift falls
LEAST_LIFT = 0.1
AGE_MAX_S = 3.0  # maximum age of power data, s; the voltage arrives at 1 Hz, and two messages can be lost


@dataclass(slots=True)
class Reported:
    """Reported battery and motor state. Effort: thrust divided by that at ``throttle_max``. NaN: unknown."""

    arrival_s: float = math.nan
    standing: bool = False  # whether the vehicle is disarmed, or no status was received
    low: bool = False  # whether the voltage at rest is too low to start a landing
    flying: float = math.nan  # vertical effort from the throttle; without a throttle, equal to ``resting``
    resting: float = math.nan  # expected effort in hover, from the voltage; used outside free flight
    sags: float = math.nan  # loss term of the voltage sag (``Reserve.sags``)
    most: float = math.nan  # effort at which the thrust command saturates, at the voltage in flight


class ReserveEstimate:
    """Estimate of the thrust reserve. Call ``step`` once a tick; ``memory`` is the complete state.

    Without a table [reserve] the battery sets no limits: it counts as fit, and the reserve is unknown.
    """

    memory: ReserveMemory
    active: bool  # whether there is a table [reserve]
    reported: Reported
    most_m_s2: Vec3  # limit of the commanded acceleration at full thrust reserve, m/s^2
    share: float  # weight of one tick in the moving average
    lasting_m_s: float  # gravity multiplied by the averaging time, m/s
    least: float  # minimum thrust reserve with which a landing continues
    reserve: float  # ratio of maximum thrust to weight; NaN if unknown
    charge: Charge  # state of the battery
    acceleration_max_m_s2: Vec3  # limit of the commanded acceleration, ENU, m/s^2; z limits only a climb
    _part: float  # usable fraction of the reserve (``Reserve.share``)

    def __init__(self, table: Reserve | None, most_m_s2: Vec3, period_s: float) -> None:
        self.memory, self.reported, self.most_m_s2 = ReserveMemory(), Reported(), most_m_s2
        self.active, self.reserve, self.charge = table is not None, math.nan, Charge.FIT
        self.share, self.lasting_m_s, self.least, self._part = 1.0, math.inf, math.nan, 1.0
        self._received: object = ()
        self._power: Power | None = None
        self.acceleration_max_m_s2 = most_m_s2
        if table is not None:
            self._table, self._part, self.charge = table, table.share, Charge.UNKNOWN
            self.share = min(1.0, period_s / table.smoothing_s)
            self.lasting_m_s = table.smoothing_s * GRAVITY_M_S2
            self.least = table.at(table.lowest_voltage_v)
            self.acceleration_max_m_s2 = allowed(most_m_s2, self.least, self._part)

    def step(
        self, power: Power | None, status: VehicleStatus | None, rise_m_s: float, now_s: float, *, flies: bool
    ) -> None:
        """Update the estimate of the reserve with the inputs of this tick."""
        if not self.active:
            return
        fresh = power is not None and now_s - power.arrival_s <= AGE_MAX_S
        standing = status is None or not status.armed
        self.receive(power if fresh else None, standing)
        # on the ground, the throttle of spinning motors does not depend on the weight
        self.update(rise_m_s, flies, status is not None and status.landed is not Landed.ON_GROUND)

    def receive(self, power: Power | None, standing: bool) -> bool:
        """Convert the reported state of battery and motors to efforts; return whether the state is new."""
        self._power = power
        if self._received == (power, standing):
            return False
        self._received, reported, table, nan = (power, standing), self.reported, self._table, math.nan
        reported.standing, reported.arrival_s, reported.low = standing, nan, False
        reported.flying = reported.resting = reported.sags = reported.most = nan
        if power is None:
            return True
        flight_v = power.voltage_v - (table.sag_v if standing else 0.0)
        known_v = table.lowest_voltage_v
        if flight_v > 0.0:
            reported.resting = table.effort(table.hover_throttle * table.hover_voltage_v / flight_v)
            known_v = flight_v
        reported.flying = reported.resting
        if power.throttle > 0.0 and math.isfinite(power.cos_tilt):
            reported.flying = table.effort(power.throttle) * power.cos_tilt
        reported.arrival_s = power.arrival_s
        reported.low = power.voltage_v - table.sag_v < table.start_voltage_v
        reported.sags, reported.most = table.sags(known_v), table.most(known_v)
        return True

    def update(self, rise_m_s: float, flies: bool, in_air: bool) -> None:
        """Estimate the reserve from the reported efforts, and set the charge; arguments as in ``step``."""
        memory, reported = self.memory, self.reported
        if reported.standing:
            memory.effort, memory.tired = math.nan, False
        effort = reported.flying if flies else reported.resting
        self.reserve = math.nan
        if not math.isnan(effort):
            if math.isnan(memory.effort):
                memory.effort, memory.rise_m_s = effort, rise_m_s
            memory.effort += self.share * (effort - memory.effort)
            memory.rise_m_s += (self.share if flies else 1.0) * (rise_m_s - memory.rise_m_s)
            # mean acceleration in the averaging time, divided by gravity
            gained = (rise_m_s - memory.rise_m_s) / self.lasting_m_s
            self.reserve = left(memory.effort / max(LEAST_LIFT, 1.0 + gained), reported.sags, reported.most)
        known = not math.isnan(self.reserve)
        if known and reported.standing:
            memory.tired = reported.low
        elif known and in_air:
            memory.tired = memory.tired or self.reserve < self.least
        self.charge = Charge.TIRED if memory.tired else Charge.FIT if known else Charge.UNKNOWN
        reserve = self.reserve if known else self.least
        self.acceleration_max_m_s2 = allowed(self.most_m_s2, reserve, self._part)

    @property
    def text(self) -> str:
        """Reason why the battery is too weak for a landing, and what to do; empty: a landing is allowed."""
        if self.charge is Charge.FIT:
            return ""
        table, power = self._table, self._power
        if power is None or self.charge is Charge.UNKNOWN:
            return "no battery voltage received (SYS_STATUS)"
        if self.reported.standing:
            return too_low(table, power.voltage_v)
        return (
            f"the thrust reserve is {self.reserve:.2f} at {power.voltage_v:.2f} V, {self.least:.2f} needed "
            f"(reserve.lowest_voltage_v is {table.lowest_voltage_v:g}): change the battery"
        )


def too_low(table: Reserve, voltage_v: float) -> str:
    """Return why a landing must not start with this voltage at rest; empty: the voltage is sufficient."""
    least_v = table.start_voltage_v + table.sag_v
    if voltage_v >= least_v:
        return ""
    return (
        f"the battery has {voltage_v:.2f} V at rest, at least {least_v:.2f} V are needed to land safely "
        "(reserve.lowest_voltage_v + start_margin_v + sag_v): charge or change it"
    )


def allowed(most_m_s2: Vec3, reserve: float, share: float) -> Vec3:
    """Return the limits of the commanded acceleration with this reserve, m/s^2."""
    (x, y, z), level = most_m_s2, level_m_s2(reserve, share)
    return (min(x, level), min(y, level), min(z, up_m_s2(reserve, share)))
