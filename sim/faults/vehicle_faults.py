"""All faults of one vehicle.

This code runs only when a fault starts, ends or is active. For a motor fault it changes two numbers of each
motor, which the compiled loop reads.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from flightstack.compiled.records import F64
from flightstack.core.types import Vec3
from sim.faults.link import CONCERNS, LinkFaults
from sim.faults.samples import EstimateFaults, SampleFaults, Shape
from sim.faults.schedule import Component, Running, ScheduledFaults
from sim.plant.params import Rotor
from sim.plant.rotors import BatteryRecord, RotorRecord
from sim.scenarios.fault_spec import Fault, Kind, What

EMPTY_V = 3.0  # cell voltage at rest; firmware platform_defaults_cf2.h: DEFAULT_BAT_CRITICAL_LOW_VOLTAGE


class MotorFaults(Component):
    """Motor faults: target speed = share * command + held; without a fault, share is 1 and held is 0.

    ``share`` and ``held`` (rpm) of M1..M4 are changed in place. ``hover_rpm``: speed at which the thrust of a
    weak motor is exact. At other speeds its error is a few per cent, because thrust is not exactly quadratic.
    """

    def __init__(self, share: F64, held: F64, rotors: RotorRecord, rotor: Rotor, hover_rpm: float) -> None:
        super().__init__()
        self._share, self._held, self._rpm = share, held, rotors.rpm
        self._rotor, self._hover_rpm = rotor, hover_rpm
        self._apply()

    def begin(self, running: Running) -> None:
        """Start a fault; if a motor has several faults, the newest applies."""
        fault, at = running.fault, _index(running)
        share = 0.0
        if fault.kind is Kind.WEAK:
            thrust_n = fault.amount * self._rotor.thrust_n(self._hover_rpm)
            share = self._rotor.rpm(thrust_n) / self._hover_rpm
        running.memory = share, float(self._rpm[at]) if fault.kind is Kind.STUCK else 0.0
        super().begin(running)
        self._apply()

    def end(self, running: Running, now_ns: int) -> None:
        super().end(running, now_ns)
        self._apply()

    def _apply(self) -> None:
        self._share[:], self._held[:] = 1.0, 0.0
        for running in self.running:
            at = _index(running)
            self._share[at], self._held[at] = running.memory


def _index(running: Running) -> int:
    """Return the index of the motor that a fault concerns."""
    assert running.fault.motor is not None
    return running.fault.motor - 1


class BatteryFaults(Component):
    """Changes the battery's record at the start of a fault, and restores it at the end."""

    def __init__(self, record: BatteryRecord) -> None:
        super().__init__()
        self._record = record

    def begin(self, running: Running) -> None:
        super().begin(running)
        b, fault = self._record, running.fault
        left_a_s = float(b.charge_a_s - b.used_a_s)
        running.memory = charge_a_s, volts = {
            Kind.DROP: (0.0, fault.amount),
            Kind.LOSS: (min(left_a_s, fault.amount * float(b.charge_a_s)), 0.0),
            Kind.OFF: (left_a_s, max(0.0, float(b.empty_v) - EMPTY_V)),
        }[fault.kind]
        self._take(charge_a_s, volts)

    def end(self, running: Running, now_ns: int) -> None:
        """Add the charge and the voltage that the fault has taken back to the battery."""
        super().end(running, now_ns)
        charge_a_s, volts = running.memory
        self._take(-charge_a_s, -volts)

    def _take(self, charge_a_s: float, volts: float) -> None:
        b = self._record
        b.full_v -= volts
        b.empty_v -= volts
        b.used_a_s += charge_a_s
        b.voltage_v -= volts + (b.full_v - b.empty_v) * charge_a_s / b.charge_a_s


MocapSample = tuple[float, ...]  # sample of motion capture: x, y, z (ENU, m), yaw (rad)


def _move_mocap(sample: MocapSample, offset: Vec3, turn: float) -> MocapSample:
    x, y, z, yaw = sample
    return (x + offset[0], y + offset[1], z + offset[2], math.remainder(yaw + turn, math.tau))


MOCAP: Shape[MocapSample] = Shape(_move_mocap, lambda first, _: first)


class Faults(ScheduledFaults):
    """Schedule and effects of one vehicle's faults; faults of the robot are ignored."""

    def __init__(
        self, faults: Sequence[Fault], seed: int, motors: MotorFaults, battery: BatteryFaults
    ) -> None:
        self.mocap = SampleFaults(MOCAP)  # faults of motion-capture samples before they reach the estimator
        self.own_state = EstimateFaults()  # faults of the state estimate before it reaches the autopilot
        self.link = LinkFaults()  # faults of the MAVLink connection; the owner of the connection applies them
        components: dict[What, Component] = {
            What.MOTOR: motors,
            What.BATTERY: battery,
            What.MOCAP: self.mocap,
            What.OWN_STATE: self.own_state,
            **dict.fromkeys(CONCERNS, self.link),
        }
        super().__init__(faults, seed, components)
        # whether the scenario has no fault of these components and none was started later
        self.quiet = not any(fault.what in components for fault in faults)

    @property
    def next_ns(self) -> int:
        """Time, ns, of the next event: start or end of a fault, release of a sample, or sampled estimate."""
        return min(self.change_ns, self.mocap.release_ns, self.own_state.due_ns)

    def fail(self, faults: Iterable[Fault], now_ns: int) -> None:
        """Add faults, and start those that are due now."""
        self.quiet = False
        self.add(faults, now_ns)
        self.run(now_ns)
