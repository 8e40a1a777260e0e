"""Parameters of the simulated autopilot, under PX4's names, units and encoding."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message

INT32 = dialect.MAV_PARAM_TYPE_INT32
REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_FLOAT = struct.Struct("<f")
_INT = struct.Struct("<i")


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: default, allowed range (both ends allowed), and whether it may change in flight."""

    name: str  # at most 16 characters
    type: int  # INT32 or REAL32, the two PX4 has
    default: float
    low: float
    high: float
    in_flight: bool = False


def _real(name: str, default: float, low: float, high: float, *, in_flight: bool = False) -> Parameter:
    return Parameter(name, REAL32, default, low, high, in_flight)


def _int(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, INT32, default, low, high)


def _fixed(name: str, value: int) -> Parameter:
    return Parameter(name, INT32, value, value, value)


# The fixed ones mean nothing here: QGroundControl's PX4 plug-in wants to find them (PX4
# mavlink_parameters.cpp, list in send()).
_FOR_QGROUNDCONTROL = (
    *(_fixed(f"CAL_MAG{i}_{kind}", 0) for i in range(4) for kind in ("ID", "ROT")),
    *(_fixed(name, 0) for name in ("CAL_ACC0_ID", "CAL_GYRO0_ID", "SENS_BOARD_ROT", "TRIG_MODE")),
    *(_fixed(name, 0) for name in ("UAVCAN_ENABLE", "SYS_AUTOSTART", "NAV_DLL_ACT")),
    *(
        Parameter(name, REAL32, 0.0, 0.0, 0.0)
        for name in ("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF", "SENS_DPRES_OFF")
    ),
    _fixed("SYS_PARAM_VER", 1),
    Parameter("BAT_CRIT_THR", REAL32, 0.07, 0.07, 0.07),  # PX4's defaults; our battery ends no flight
    Parameter("BAT_EMERGEN_THR", REAL32, 0.05, 0.05, 0.05),
    Parameter("BAT_LOW_THR", REAL32, 0.15, 0.15, 0.15),
)


def table(system_id: int) -> tuple[Parameter, ...]:
    """All parameters, by name; the order is their index on the wire."""
    own = (
        _real("COM_OF_LOSS_T", 0.5, 0.1, 5.0),  # s, silence of the companion before landing
        _int("COM_OBL_RC_ACT", 4, 4, 4),  # what is done then: land, nothing else is implemented
        _real("COM_DISARM_LAND", 2.0, 0.1, 20.0),  # s, PX4's default
        _real("COM_DISARM_PRFLT", 10.0, 1.0, 120.0),  # s, PX4's default
        _int("COM_RC_IN_MODE", 4, 4, 4),  # no stick input
        _real("MIS_TAKEOFF_ALT", 0.5, 0.1, 20.0, in_flight=True),  # m above home
        _real("MPC_TKO_SPEED", 0.5, 0.1, 1.0, in_flight=True),  # m/s
        _real("MPC_LAND_SPEED", 0.3, 0.1, 0.8, in_flight=True),  # m/s
        _real("MPC_XY_CRUISE", 0.5, 0.1, 2.0, in_flight=True),  # m/s, highest when flying by itself
        _real("MPC_XY_P", 1.0, 0.1, 2.0, in_flight=True),  # 1/s
        _real("MPC_Z_P", 1.0, 0.1, 1.5, in_flight=True),  # 1/s
        _fixed("MAV_SYS_ID", system_id),
        _fixed("MAV_COMP_ID", dialect.MAV_COMP_ID_AUTOPILOT1),
        _fixed("MAV_TYPE", dialect.MAV_TYPE_QUADROTOR),
    )
    return tuple(sorted((*own, *_FOR_QGROUNDCONTROL), key=lambda parameter: parameter.name))


class Parameters:
    """The values in force; read as ``parameters["COM_OF_LOSS_T"]``."""

    def __init__(self, system_id: int) -> None:
        self._table = table(system_id)
        self._index = {parameter.name: i for i, parameter in enumerate(self._table)}
        self._values = {parameter.name: parameter.default for parameter in self._table}

    def __getitem__(self, name: str) -> float:
        """Value of a parameter.

        Raises:
            KeyError: there is none of that name.
        """
        return self._values[name]

    def __len__(self) -> int:
        return len(self._table)

    def find(self, name: str, index: int) -> str | None:
        """Name of the parameter asked for by name (index -1) or by index; None if there is none."""
        if index >= 0:
            return self._table[index].name if index < len(self._table) else None
        return name if name in self._index else None

    def message(self, name: str) -> Message:
        """PARAM_VALUE of a parameter; an integer travels as its bits in the float field, as with PX4."""
        index = self._index[name]
        parameter = self._table[index]
        value = self._values[name]
        if parameter.type == INT32:
            (value,) = _FLOAT.unpack(_INT.pack(int(value)))
        return dialect.MAVLink_param_value_message(
            name.encode(), value, parameter.type, len(self._table), index
        )

    def messages(self) -> list[Message]:
        """PARAM_VALUE of every parameter, in order of index."""
        return [self.message(parameter.name) for parameter in self._table]

    def set(self, name: str, wire_value: float, type_: int, *, armed: bool) -> str | None:
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
        if type_ != parameter.type:
            return f"{name}: type {type_}, want {parameter.type}"
        value = float(_INT.unpack(_FLOAT.pack(wire_value))[0]) if type_ == INT32 else wire_value
        # Single precision: the end of a range must not refuse its own neighbour.
        slack = 1e-6 * max(1.0, abs(parameter.low), abs(parameter.high))
        if not (math.isfinite(value) and parameter.low - slack <= value <= parameter.high + slack):
            return f"{name}: {value:.6g}, allowed {parameter.low:g} to {parameter.high:g}"
        if armed and not parameter.in_flight:
            return f"{name}: only while disarmed"
        self._values[name] = min(max(value, parameter.low), parameter.high)
        return None
