"""MAVLink commands of the simulated autopilot: one table from MAV_CMD to what is done.

Every command may come again, since an acknowledgement can be lost and MAVSDK does not count its repeats:
what is already so is ACCEPTED. A parameter that is NaN means "the default".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message
from sim.autopilot_flight import Flight
from sim.autopilot_messages import BUILDERS, Snapshot
from sim.autopilot_modes import FlightMode, mode_from_code
from sim.autopilot_setpoints import Sender
from sim.autopilot_streams import Streams

ACCEPTED: int = dialect.MAV_RESULT_ACCEPTED
REJECTED: int = dialect.MAV_RESULT_TEMPORARILY_REJECTED
DENIED: int = dialect.MAV_RESULT_DENIED
UNSUPPORTED: int = dialect.MAV_RESULT_UNSUPPORTED
FAILED: int = dialect.MAV_RESULT_FAILED

FORCE = 21196.0  # magic of a forced disarm (MAV_CMD_COMPONENT_ARM_DISARM, param2)
_CUSTOM_MODE = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_INT32_MAX = float(2**31 - 1)
_INT_NAN = 0x7FF80000  # how a careless client's NaN looks as an integer (PX4 mavlink_receiver.cpp)
_INT_SCALE = 1e-7  # COMMAND_INT carries degrees times 1e7


@dataclass(frozen=True, slots=True)
class Command:
    """COMMAND_LONG and COMMAND_INT in one form; ``params[0]`` is param1."""

    number: int  # MAV_CMD
    params: tuple[float, float, float, float, float, float, float]
    sender: Sender
    now_s: float

    def given(self, n: int) -> float | None:
        """Parameter n (from 1), None when it was left out."""
        value = self.params[n - 1]
        return None if math.isnan(value) else value


def read_command(message: Any, sender: Sender, now_s: float) -> Command | None:
    """Bring a COMMAND_LONG or COMMAND_INT into one form; None if its numbers are no numbers."""
    m = message
    if m.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_INT:
        if m.x == m.y == _INT_NAN:
            return None
        params = (m.param1, m.param2, m.param3, m.param4, m.x * _INT_SCALE, m.y * _INT_SCALE, m.z)
    else:
        params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        if abs(m.param5) >= _INT32_MAX or abs(m.param6) >= _INT32_MAX:
            return None
    if any(map(math.isinf, params)):
        return None
    return Command(m.command, params, sender, now_s)


class Commands:
    """Runs commands. Handlers return MAV_RESULT and leave messages for the sender in ``extra``."""

    def __init__(self, flight: Flight, streams: Streams, snapshot: Callable[[float], Snapshot]) -> None:
        self._flight = flight
        self._streams = streams
        self._snapshot = snapshot
        self.extra: list[Message] = []
        m = dialect
        self._table: dict[int, Callable[[Command], int]] = {
            m.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            m.MAV_CMD_NAV_TAKEOFF: self._take_off,
            m.MAV_CMD_NAV_LAND: self._land,
            m.MAV_CMD_DO_SET_MODE: self._set_mode,
            m.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            m.MAV_CMD_RUN_PREARM_CHECKS: self._prearm_checks,
            m.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            m.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            m.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            m.MAV_CMD_GET_HOME_POSITION: self._home,
        }

    def run(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Run a command that is meant for us; returns the acknowledgement and what was asked for."""
        self.extra = []
        command = read_command(message, sender, now_s)
        if command is None:
            self._flight.say(dialect.MAV_SEVERITY_WARNING, f"Command {message.command} denied: bad parameter")
            result = DENIED
        else:
            handler = self._table.get(command.number)
            if handler is None:
                self._flight.say(dialect.MAV_SEVERITY_WARNING, f"Command {command.number} is not supported")
                result = UNSUPPORTED
            else:
                result = handler(command)
        ack = dialect.MAVLink_command_ack_message(message.command, result, 0, 0, *sender)
        return [ack, *self.extra]

    def _refuse(self, reason: str | None, result: int = REJECTED) -> int:
        if reason is None:
            return ACCEPTED
        self._flight.say(dialect.MAV_SEVERITY_WARNING, reason)
        return result

    def _arm_disarm(self, command: Command) -> int:
        arm, force = command.given(1), command.given(2)
        if arm is None or round(arm) not in (0, 1):
            return self._refuse("Arm or disarm? param1 must be 0 or 1", UNSUPPORTED)
        if round(arm) == 1:
            return self._refuse(self._flight.arm(command.now_s))  # force does not skip checks, as with PX4
        return self._refuse(self._flight.disarm(force=force == FORCE))

    def _take_off(self, command: Command) -> int:
        return self._refuse(self._flight.take_off(command.given(7)))

    def _land(self, command: Command) -> int:
        del command
        self._flight.land()
        return ACCEPTED

    def _set_mode(self, command: Command) -> int:
        base, main, sub = command.given(1) or 0.0, command.given(2), command.given(3) or 0.0
        if not int(base) & _CUSTOM_MODE or main is None:
            return self._refuse("Mode refused: only PX4's custom modes", DENIED)
        mode = mode_from_code(round(main), round(sub))
        if mode is None:
            return self._refuse(f"Mode {main:.0f}/{sub:.0f} refused: there is none", DENIED)
        return self.set_mode(mode, command.now_s)

    def set_mode(self, mode: FlightMode, now_s: float) -> int:
        """Change the mode, saying why not."""
        return self._refuse(self._flight.set_mode(mode, now_s))

    def _terminate(self, command: Command) -> int:
        if not (command.given(1) or 0.0) > 0.5:
            return ACCEPTED
        if not self._flight.vehicle.armed:
            return self._refuse("Termination refused: not armed", DENIED)
        return self._refuse(self._flight.disarm(force=True))

    def _prearm_checks(self, command: Command) -> int:
        del command
        if self._flight.vehicle.armed:
            return self._refuse("Checks refused: armed")
        for problem in self._flight.problems():
            self._flight.say(dialect.MAV_SEVERITY_WARNING, f"Preflight fail: {problem}")
        return ACCEPTED

    def _set_interval(self, command: Command) -> int:
        message_id, interval_us = _integer(command.given(1)), command.given(2) or 0.0
        if message_id is None or not self._streams.known(message_id):
            return FAILED  # as PX4 does, HEARTBEAT included
        self._streams.set_interval(message_id, interval_us, command.now_s)
        return ACCEPTED

    def _get_interval(self, command: Command) -> int:
        message_id = _integer(command.given(1))
        if message_id is None or not self._streams.known(message_id):
            return FAILED
        interval_us = self._streams.interval_us(message_id)
        self.extra.append(dialect.MAVLink_message_interval_message(message_id, interval_us))
        return ACCEPTED

    def _request_message(self, command: Command) -> int:
        return self._give(_integer(command.given(1)), command.now_s)

    def _capabilities(self, command: Command) -> int:
        if command.given(1) != 1.0:
            return DENIED
        return self._give(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, command.now_s)

    def _home(self, command: Command) -> int:
        return self._give(dialect.MAVLINK_MSG_ID_HOME_POSITION, command.now_s)

    def _give(self, message_id: int | None, now_s: float) -> int:
        builder = BUILDERS.get(message_id) if message_id is not None else None
        if builder is None:
            return DENIED  # QGroundControl takes an ACCEPTED as a promise and waits for it
        self.extra.append(builder(self._snapshot(now_s)))
        return ACCEPTED


def _integer(value: float | None) -> int | None:
    return int(value) if value is not None and value == int(value) else None
