"""MAV_CMD_INJECT_FAILURE: MAVLink's failure units and types in terms of our faults."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.scenarios.fault_spec import Fault, Kind, What

MOTORS = (1, 2, 3, 4)
OK: int = dialect.FAILURE_TYPE_OK

Make = Callable[[tuple[int, ...]], list[Fault]]  # from motor numbers

_OFFSET_M = (0.3, 0.0, 0.0)  # error of a wrong position


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
# unit and type (except OK) to faults, with the defaults of the table
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
# faults that FAILURE_TYPE_OK heals
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
    """Numbers of the motors (none for other units), or why there is no such instance."""
    if unit != dialect.FAILURE_UNIT_SYSTEM_MOTOR:
        if instance in (0, 1):
            return ()
        return f"{UNITS[unit]}: found instance {instance}, allowed: 0 or 1"
    if instance == 0:
        return MOTORS
    return (instance,) if instance in MOTORS else f"{UNITS[unit]}: found instance {instance}, allowed: 0 to 4"


def faults_of(unit: int, kind: int, instance: int) -> list[Fault] | str:
    """Faults of FAILURE_UNIT, FAILURE_TYPE and instance (0: all), none for OK; or why it is not simulated."""
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
