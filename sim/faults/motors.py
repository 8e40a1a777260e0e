"""Faults of the motors: what they make of the commanded speeds."""

from __future__ import annotations

from sim.compiled.records import F64
from sim.faults.schedule import Running
from sim.plant.params import Rotor
from sim.plant.rotors import RotorRecord
from sim.scenarios.fault_table import Kind


class MotorFaults:
    """Speed that a motor aims at = share * commanded + held; share 1 and held 0 when it is sound.

    Args:
        share: of M1..M4, changed in place.
        held: of M1..M4, rpm, changed in place.
        rotors: present speeds.
        rotor: static map of the thrust.
        hover_rpm: speed at which the share of the thrust of a weak motor is exact; elsewhere within some
            per cent, since thrust is not quite a square of the speed.
    """

    def __init__(self, share: F64, held: F64, rotors: RotorRecord, rotor: Rotor, hover_rpm: float) -> None:
        self._share, self._held, self._rpm = share, held, rotors.rpm
        self._rotor, self._hover_rpm = rotor, hover_rpm
        self._running: list[tuple[Running, float, float]] = []
        share[:], held[:] = 1.0, 0.0

    def begin(self, running: Running) -> None:
        """A fault is on; of several on one motor the newest counts."""
        fault = running.fault
        assert fault.motor is not None
        share = held = 0.0
        if fault.kind is Kind.WEAK:
            thrust_n = fault.amount * self._rotor.thrust_n(self._hover_rpm)
            share = self._rotor.rpm(thrust_n) / self._hover_rpm
        elif fault.kind is Kind.STUCK:
            held = float(self._rpm[fault.motor - 1])
        self._running.append((running, share, held))
        self._apply()

    def end(self, running: Running, now_ns: int) -> None:
        """It is over."""
        del now_ns
        self._running = [one for one in self._running if one[0] is not running]
        self._apply()

    def _apply(self) -> None:
        self._share[:], self._held[:] = 1.0, 0.0
        for running, share, held in self._running:
            motor = running.fault.motor
            assert motor is not None
            self._share[motor - 1], self._held[motor - 1] = share, held
