"""All faults of one vehicle, scheduled or from MAV_CMD_INJECT_FAILURE, and their messages.

This code runs only when a fault starts, ends or is active; the compiled loop has only two values per motor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.compiled.records import F64
from flightstack.core.types import Vec3
from sim.faults.link import CONCERNS, LinkFaults
from sim.faults.samples import EstimateFaults, SampleFaults, Shape
from sim.faults.schedule import RUNNING_MAX, Effect, Running, ScheduledFaults
from sim.plant.params import Rotor
from sim.plant.rotors import BatteryRecord, RotorRecord
from sim.scenarios.fault_spec import After, Fault, Kind, What

EMPTY_V = 3.0  # cell voltage at rest; firmware platform_defaults_cf2.h: DEFAULT_BAT_CRITICAL_LOW_VOLTAGE


class MotorFaults:
    """Motor faults: target speed = share * command + held; without a fault, share is 1 and held is 0.

    ``share`` and ``held`` (rpm) of M1..M4 are changed in place. ``hover_rpm``: speed at which the thrust of a
    weak motor is exact. At other speeds the error is some per cent, because thrust is not exactly quadratic.
    """

    def __init__(self, share: F64, held: F64, rotors: RotorRecord, rotor: Rotor, hover_rpm: float) -> None:
        self._share, self._held, self._rpm = share, held, rotors.rpm
        self._rotor, self._hover_rpm = rotor, hover_rpm
        self._running: list[tuple[Running, float, float]] = []
        share[:], held[:] = 1.0, 0.0

    def begin(self, running: Running) -> None:
        """Start a fault; if a motor has several faults, the newest applies."""
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
        del now_ns
        self._running = [one for one in self._running if one[0] is not running]
        self._apply()

    def _apply(self) -> None:
        self._share[:], self._held[:] = 1.0, 0.0
        for running, share, held in self._running:
            motor = running.fault.motor
            assert motor is not None
            self._share[motor - 1], self._held[motor - 1] = share, held


class BatteryFaults:
    """Changes the battery's record at the start of a fault, and restores it at the end."""

    def __init__(self, record: BatteryRecord) -> None:
        self._record = record
        self._taken: dict[Running, tuple[float, float]] = {}  # removed charge (A s) and voltage (V)

    def begin(self, running: Running) -> None:
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
        """Restore the charge and the voltage that the fault has taken from the battery."""
        del now_ns
        charge_a_s, volts = self._taken.pop(running)
        self._take(-charge_a_s, -volts)

    def _take(self, charge_a_s: float, volts: float) -> None:
        b = self._record
        b.full_v -= volts
        b.empty_v -= volts
        b.used_a_s += charge_a_s
        b.voltage_v -= volts + (b.full_v - b.empty_v) * charge_a_s / b.charge_a_s


MOTORS = (1, 2, 3, 4)
OK: int = dialect.FAILURE_TYPE_OK

Make = Callable[[tuple[int, ...]], list[Fault]]  # function from motor numbers to faults

_OFFSET_M = (0.3, 0.0, 0.0)  # position error of a "wrong" measurement


def _motors(kind: Kind) -> Make:
    return lambda motors: [Fault(What.MOTOR, kind, motor=motor) for motor in motors]


def _mocap(kind: Kind) -> Make:
    offset_m = _OFFSET_M if kind is Kind.WRONG else None
    return lambda _: [Fault(What.MOCAP, kind, offset_m=offset_m)]


def _link(*kinds: Kind) -> Make:
    return lambda _: [Fault(what, kind) for kind in kinds for what in (What.LINK_OUT, What.LINK_IN)]


_D = dialect
_TYPES: dict[int, Kind] = {
    _D.FAILURE_TYPE_OFF: Kind.OFF,
    _D.FAILURE_TYPE_STUCK: Kind.STUCK,
    _D.FAILURE_TYPE_GARBAGE: Kind.GARBAGE,
    _D.FAILURE_TYPE_WRONG: Kind.WRONG,
    _D.FAILURE_TYPE_SLOW: Kind.SLOW,
    _D.FAILURE_TYPE_DELAYED: Kind.DELAYED,
    _D.FAILURE_TYPE_INTERMITTENT: Kind.INTERMITTENT,
}
_POSITION: dict[int, Make] = {type_: _mocap(kind) for type_, kind in _TYPES.items()}
# failure unit and type (except OK) to faults, with the defaults of the fault table
FAILURES: dict[int, dict[int, Make]] = {
    _D.FAILURE_UNIT_SENSOR_GPS: _POSITION,
    _D.FAILURE_UNIT_SENSOR_VIO: _POSITION,
    _D.FAILURE_UNIT_SYSTEM_MOTOR: {
        _D.FAILURE_TYPE_OFF: _motors(Kind.DEAD),
        _D.FAILURE_TYPE_STUCK: _motors(Kind.STUCK),
        _D.FAILURE_TYPE_WRONG: _motors(Kind.WEAK),
    },
    _D.FAILURE_UNIT_SYSTEM_BATTERY: {
        _D.FAILURE_TYPE_OFF: lambda _: [Fault(What.BATTERY, Kind.OFF)],
        _D.FAILURE_TYPE_WRONG: lambda _: [Fault(What.BATTERY, Kind.DROP)],
    },
    _D.FAILURE_UNIT_SYSTEM_MAVLINK_SIGNAL: {
        type_: _link(Kind.REORDER, Kind.DUPLICATE) if kind is Kind.WRONG else _link(kind)
        for type_, kind in _TYPES.items()
    },
}
# components whose faults FAILURE_TYPE_OK ends, by failure unit
PARTS: dict[int, frozenset[What]] = {
    unit: frozenset(fault.what for make in kinds.values() for fault in make(MOTORS))
    for unit, kinds in FAILURES.items()
}


def _names(prefix: str) -> dict[int, str]:
    found = {k: v for k, v in vars(dialect).items() if k.startswith(prefix) and not k.endswith("_ENUM_END")}
    return {number: name.removeprefix(prefix) for name, number in found.items()}


UNITS = _names("FAILURE_UNIT_")
TYPES = _names("FAILURE_TYPE_")


def motors_of(unit: int, instance: int) -> tuple[int, ...] | str:
    """Return the numbers of the motors (none for other units), or an error text for an invalid instance."""
    if unit != dialect.FAILURE_UNIT_SYSTEM_MOTOR:
        if instance in (0, 1):
            return ()
        return f"{UNITS[unit]}: found instance {instance}, allowed: 0 or 1"
    if instance == 0:
        return MOTORS
    return (instance,) if instance in MOTORS else f"{UNITS[unit]}: found instance {instance}, allowed: 0 to 4"


def faults_of(unit: int, kind: int, instance: int) -> list[Fault] | str:
    """Return the faults of FAILURE_UNIT, FAILURE_TYPE and instance (0: all), or an error text; OK: none."""
    if unit not in FAILURES:
        names = ", ".join(UNITS[u] for u in FAILURES)
        return f"failure unit {UNITS.get(unit, unit)} is not simulated; these are: {names}"
    kinds = FAILURES[unit]
    if kind != OK and kind not in kinds:
        names = ", ".join(["OK", *(TYPES[k] for k in kinds)])
        return f"{UNITS[unit]}: failure type {TYPES.get(kind, kind)} is not simulated; these are: {names}"
    motors = motors_of(unit, instance)
    if isinstance(motors, str) or kind == OK:
        return motors if isinstance(motors, str) else []
    return kinds[kind](motors)


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
        self.link = LinkFaults()  # faults of the MAVLink connection, applied by its owner
        effects: dict[What, Effect] = {
            What.MOTOR: motors,
            What.BATTERY: battery,
            What.MOCAP: self.mocap,
            What.OWN_STATE: self.own_state,
            **dict.fromkeys(CONCERNS, self.link),
        }
        super().__init__(faults, seed, effects)
        # whether there was no fault and none is scheduled
        self.quiet = not any(fault.what in effects for fault in faults)

    @property
    def next_ns(self) -> int:
        """Time of the next start or end of a fault, or of the next due or delayed sample."""
        return min(self._schedule.next_ns, self.mocap.release_ns, self.own_state.due_ns)

    @property
    def waits_for_takeoff(self) -> bool:
        """Whether ``took_off`` must be called at the take-off."""
        return self._schedule.waits_for(After.TAKEOFF)

    def took_off(self, now_ns: int) -> None:
        """Start faults that are relative to the first take-off."""
        self._schedule.refer(After.TAKEOFF, now_ns)

    def inject(self, unit: int, kind: int, instance: int, now_ns: int) -> str | None:
        """Apply MAV_CMD_INJECT_FAILURE; return the reason of a rejection. OK also ends scheduled faults."""
        found = faults_of(unit, kind, instance)
        if isinstance(found, str):
            return found
        if kind == OK:
            self._heal(unit, instance, now_ns)
            return None
        active = {running.fault for running in self._schedule.active}
        fresh = [fault for fault in found if fault not in active]  # repeated commands are ignored
        if len(active) + len(fresh) > RUNNING_MAX:
            return f"{len(active)} faults are on, at most {RUNNING_MAX} are possible; heal some"
        self.fail(fresh, now_ns)
        return None

    def fail(self, faults: Iterable[Fault], now_ns: int) -> None:
        """Start faults now; a fault relative to ``time`` does not start before its time."""
        self.quiet = False
        self._schedule.add(faults, now_ns)
        self.run(now_ns)

    def _heal(self, unit: int, instance: int, now_ns: int) -> None:
        motors = motors_of(unit, instance)
        for running in self._schedule.active:
            fault = running.fault
            meant = fault.what in PARTS[unit] and (fault.motor is None or fault.motor in motors)
            if meant and fault.cell.healable:
                self._apply(self._schedule.end(running), now_ns)
