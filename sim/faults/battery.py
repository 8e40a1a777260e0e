"""Faults of the battery: less charge, or less voltage."""

from __future__ import annotations

from sim.faults.schedule import Running
from sim.plant.battery import BatteryRecord
from sim.scenarios.fault_table import Kind

EMPTY_V = 3.0  # at rest; firmware platform_defaults_cf2.h: DEFAULT_BAT_CRITICAL_LOW_VOLTAGE


class BatteryFaults:
    """Changes the battery's record when a fault begins, and back when it ends.

    Args:
        record: of the battery.
    """

    def __init__(self, record: BatteryRecord) -> None:
        self._record = record
        self._taken: dict[Running, tuple[float, float]] = {}  # charge (A s) and voltage (V)

    def begin(self, running: Running) -> None:
        """A fault is on."""
        b, fault = self._record, running.fault
        left_a_s = float(b.charge_a_s - b.used_a_s)
        charge_a_s, volts = {
            Kind.DROP: (0.0, fault.amount),
            Kind.LOSS: (min(left_a_s, fault.amount * float(b.charge_a_s)), 0.0),
            Kind.OFF: (left_a_s, max(0.0, float(b.empty_v) - EMPTY_V)),
        }[fault.kind]
        self._taken[running] = (charge_a_s, volts)
        self._take(charge_a_s, volts)

    def end(self, running: Running, now_ns: int) -> None:
        """It is over: what it took is back."""
        del now_ns
        charge_a_s, volts = self._taken.pop(running)
        self._take(-charge_a_s, -volts)

    def _take(self, charge_a_s: float, volts: float) -> None:
        b = self._record
        b.full_v -= volts
        b.empty_v -= volts
        b.used_a_s += charge_a_s
        b.voltage_v -= volts + (b.full_v - b.empty_v) * charge_a_s / b.charge_a_s
