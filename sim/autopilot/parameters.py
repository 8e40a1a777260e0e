"""Parameters of the simulated autopilot, under PX4's names and units unless a personality has others."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message

INT32 = dialect.MAV_PARAM_TYPE_INT32
REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_FLOAT = struct.Struct("<f")
_INT = struct.Struct("<i")
_LIST_AT_ONCE = 20  # values of a list in one tick, as many as PX4 sends at once on UDP
_OUT_OF_RANGE = dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE  # the dialect has none for a wrong type
_READ_ONLY = dialect.MAV_PARAM_ERROR_READ_ONLY
NOT_NOW = dialect.MAV_PARAM_ERROR_PERMISSION_DENIED


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: default, allowed range (both ends allowed), and whether it may change in flight."""

    name: str  # at most 16 characters
    type: int  # MAV_PARAM_TYPE; PX4 has INT32 and REAL32 alone
    default: float
    low: float
    high: float
    in_flight: bool = False
    choices: tuple[int, ...] = ()  # when only some values of the range mean something
    stands_for: tuple[str, ...] = ()  # names inside the simulator; empty: its own
    scale: float = 1.0  # of the value on the wire to that inside
    meanings: Mapping[int, int] = field(default_factory=dict)  # value on the wire to that inside

    @property
    def names(self) -> tuple[str, ...]:
        """Names inside the simulator."""
        return self.stands_for or (self.name,)

    def inside(self, value: float) -> float:
        """Value on the wire to value inside."""
        return self.meanings[int(value)] if self.meanings else value / self.scale

    def outside(self, value: float) -> float:
        """Value inside to value on the wire."""
        if self.meanings:
            return next(wire for wire, meaning in self.meanings.items() if meaning == value)
        return value * self.scale

    @property
    def allowed(self) -> str:
        """Allowed values in words."""
        if self.choices:
            return ", ".join(map(str, self.choices))
        return f"{self.low:g} to {self.high:g}" if self.low < self.high else f"{self.low:g}"

    def accepts(self, value: float) -> bool:
        """Whether a value is allowed."""
        # Single precision: the end of a range must not refuse its own neighbour.
        slack = 1e-6 * max(1.0, abs(self.low), abs(self.high))
        if not (math.isfinite(value) and self.low - slack <= value <= self.high + slack):
            return False
        return not self.choices or value in self.choices


def _real(name: str, default: float, low: float, high: float, *, in_flight: bool = False) -> Parameter:
    return Parameter(name, REAL32, default, low, high, in_flight)


def _int(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, INT32, default, low, high)


def _one_of(name: str, default: int, *choices: int) -> Parameter:
    return Parameter(name, INT32, default, choices[0], choices[-1], choices=choices)


def _fixed(name: str, value: int) -> Parameter:
    return Parameter(name, INT32, value, value, value)


# The fixed ones mean nothing here: QGroundControl's PX4 plug-in wants to find them (PX4
# mavlink_parameters.cpp, list in send()).
_FOR_QGROUNDCONTROL = (
    *(_fixed(f"CAL_MAG{i}_{kind}", 0) for i in range(4) for kind in ("ID", "ROT")),
    *(_fixed(name, 0) for name in ("CAL_ACC0_ID", "CAL_GYRO0_ID", "SENS_BOARD_ROT", "TRIG_MODE")),
    *(_fixed(name, 0) for name in ("UAVCAN_ENABLE", "SYS_AUTOSTART")),
    *(
        Parameter(name, REAL32, 0.0, 0.0, 0.0)
        for name in ("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF", "SENS_DPRES_OFF")
    ),
    _fixed("SYS_PARAM_VER", 1),
)

# Values of the ..._ACT parameters: tables in autopilot_watches.
_OWN = (
    _real("COM_OF_LOSS_T", 0.5, 0.1, 5.0),  # s, silence of the companion before COM_OBL_RC_ACT
    _one_of("COM_OBL_RC_ACT", 4, 0, 3, 4, 5),  # then: land, return, land, hold
    _real("COM_DISARM_LAND", 2.0, 0.1, 20.0),  # s, PX4's default
    _real("COM_DISARM_PRFLT", 10.0, 1.0, 120.0),  # s, PX4's default
    _fixed("COM_RC_IN_MODE", 4),  # no stick input
    _one_of("COM_LOW_BAT_ACT", 0, 0, 2, 3),  # warn; land when critical; return, and land in emergency
    _int("COM_DL_LOSS_T", 10, 1, 300),  # s without a ground station's heartbeat before NAV_DLL_ACT
    _one_of("NAV_DLL_ACT", 0, 0, 1, 2, 3),  # then: nothing, hold, return, land
    _real("BAT_LOW_THR", 0.15, 0.12, 0.5),  # share of charge; these three are PX4's
    _real("BAT_CRIT_THR", 0.07, 0.05, 0.5),
    _real("BAT_EMERGEN_THR", 0.05, 0.03, 0.5),
    _real("BAT1_V_EMPTY", 3.5, 2.5, 4.0),  # V at rest; the simulated cell's
    _real("BAT1_V_CHARGED", 4.15, 3.5, 4.35),  # V at rest
    _real("BAT1_V_LOAD_DROP", 0.37, 0.0, 1.0),  # V at full throttle; 0.25 V in hover at 0.67
    _one_of("GF_ACTION", 2, 0, 1, 2, 3, 5),  # outside: nothing, warn, hold, return, land
    _real("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0),  # m from home; 0: no limit
    _real("GF_MAX_VER_DIST", 0.0, 0.0, 10000.0),  # m above home; 0: no limit
    _real("RTL_RETURN_ALT", 1.0, 0.1, 20.0),  # m above home, on the way back
    _real("RTL_MIN_DIST", 0.3, 0.0, 20.0),  # m; nearer to home it lands where it is
    _real("RTL_LAND_DELAY", 0.0, 0.0, 60.0),  # s over home before it lands
    _int("SYS_FAILURE_EN", 0, 0, 1),  # command 420 may let things fail
    _real("MIS_TAKEOFF_ALT", 0.5, 0.1, 20.0, in_flight=True),  # m above where it stands
    _real("MPC_TKO_SPEED", 0.5, 0.1, 1.0, in_flight=True),  # m/s
    _real("MPC_LAND_SPEED", 0.3, 0.1, 0.8, in_flight=True),  # m/s
    _real("MPC_XY_CRUISE", 0.5, 0.1, 2.0, in_flight=True),  # m/s, highest when flying by itself
    # m/s; set-points are clipped to these. The defaults are never met: above 5 m/s a set-point is refused.
    _real("MPC_XY_VEL_MAX", 5.0, 0.1, 20.0),
    _real("MPC_Z_VEL_MAX_UP", 5.0, 0.1, 8.0),
    _real("MPC_Z_VEL_MAX_DN", 5.0, 0.1, 8.0),
    _real("MPC_XY_P", 1.0, 0.1, 2.0, in_flight=True),  # 1/s
    _real("MPC_Z_P", 1.0, 0.1, 1.5, in_flight=True),  # 1/s
    _fixed("MAV_COMP_ID", dialect.MAV_COMP_ID_AUTOPILOT1),
    _fixed("MAV_TYPE", dialect.MAV_TYPE_QUADROTOR),
)


def table(system_id: int) -> tuple[Parameter, ...]:
    """All parameters, by name; the order is their index on the wire."""
    all_ = (*_OWN, *_FOR_QGROUNDCONTROL, _fixed("MAV_SYS_ID", system_id))
    return tuple(sorted(all_, key=lambda parameter: parameter.name))


class Refused(NamedTuple):
    """A write that was not done."""

    error: int  # MAV_PARAM_ERROR
    reason: str


class Parameters:
    """The values in force; read as ``parameters["COM_OF_LOSS_T"]``, whatever they are called on the wire.

    Attributes:
        version: changes with every write.
        left_to_list: values of a list that are still to be sent.
    """

    def __init__(
        self, system_id: int, rows: tuple[Parameter, ...] | None = None, *, bytewise: bool = True
    ) -> None:
        """Begin with the defaults.

        Args:
            system_id: of the vehicle.
            rows: those on the wire; None: PX4's.
            bytewise: an integer travels as its bits in the float field, as with PX4; else as its value.
        """
        own = table(system_id)
        self._table = own if rows is None else rows
        self._bytewise = bytewise
        self._index = {parameter.name: i for i, parameter in enumerate(self._table)}
        self._values = {parameter.name: parameter.default for parameter in own}
        for parameter in self._table:
            self._values |= dict.fromkeys(parameter.names, parameter.inside(parameter.default))
        self.version = 0
        self.left_to_list = self._next = 0

    def __getitem__(self, name: str) -> float:
        """Value of a parameter.

        Raises:
            KeyError: there is none of that name.
        """
        return self._values[name]

    def __len__(self) -> int:
        return len(self._table)

    def entry(self, name: str) -> Parameter:
        """Type and range of a parameter.

        Raises:
            KeyError: there is none of that name.
        """
        return self._table[self._index[name]]

    def find(self, name: str, index: int) -> str | None:
        """Name of the parameter asked for by name (index -1) or by index; None if there is none."""
        if index >= 0:
            return self._table[index].name if index < len(self._table) else None
        return name if name in self._index else None

    def message(self, name: str) -> Message:
        """PARAM_VALUE of a parameter."""
        index = self._index[name]
        parameter = self._table[index]
        value = parameter.outside(self._values[parameter.names[0]])
        if parameter.type == INT32 and self._bytewise:
            (value,) = _FLOAT.unpack(_INT.pack(int(value)))
        return dialect.MAVLink_param_value_message(
            name.encode(), value, parameter.type, len(self._table), index
        )

    def preset(self, name: str, value: float) -> None:
        """Set a parameter before anything flies; what is fixed stays.

        Args:
            name: on the wire.
            value: on the wire, in its unit.

        Raises:
            ValueError: no such parameter, or a value that is not allowed; the text says what is.
        """
        if name not in self._index:
            raise ValueError(f"parameter {name!r} is not known: allowed is {', '.join(self._index)}")
        parameter = self.entry(name)
        if not parameter.accepts(value) or (parameter.type != REAL32 and value != int(value)):
            raise ValueError(f"parameter {name}: found {value:g}, allowed is {parameter.allowed}")
        self._values |= dict.fromkeys(parameter.names, parameter.inside(value))
        self.version += 1

    def list_all(self) -> None:
        """Begin to send every value; whoever asks meanwhile gets all of them too."""
        self.left_to_list = len(self._table)

    def listing(self) -> list[Message]:
        """PARAM_VALUE of the next ones of a list; empty when none is on its way."""
        count = min(_LIST_AT_ONCE, self.left_to_list)
        names = [self._table[(self._next + i) % len(self._table)].name for i in range(count)]
        self.left_to_list -= count
        self._next = (self._next + count) % len(self._table) if self.left_to_list else 0
        return [self.message(name) for name in names]

    def set(self, name: str, wire_value: float, type_: int, *, armed: bool) -> Refused | None:
        """Write a parameter from PARAM_SET.

        Args:
            name: a known name.
            wire_value: the message's float field.
            type_: MAV_PARAM_TYPE of the message.
            armed: whether the vehicle is armed.

        Returns:
            Why it was refused, None when it was written.
        """
        parameter = self._table[self._index[name]]
        if self._bytewise and type_ != parameter.type:
            return Refused(_OUT_OF_RANGE, f"{name}: ignored, type {type_} instead of {parameter.type}")
        bits = self._bytewise and type_ == INT32
        value = float(_INT.unpack(_FLOAT.pack(wire_value))[0]) if bits else wire_value
        if not self._bytewise and parameter.type != REAL32 and math.isfinite(value):
            value = float(math.trunc(value + math.copysign(0.01, value)))  # as ArduPilot's AP_Param
        if not parameter.accepts(value):
            error = _OUT_OF_RANGE if parameter.low < parameter.high else _READ_ONLY
            return Refused(error, f"{name}: {value:.6g}, allowed {parameter.allowed}")
        if armed and not parameter.in_flight:
            return Refused(NOT_NOW, f"{name}: only while disarmed")
        inside = parameter.inside(min(max(value, parameter.low), parameter.high))
        self._values |= dict.fromkeys(parameter.names, inside)
        self.version += 1
        return None
