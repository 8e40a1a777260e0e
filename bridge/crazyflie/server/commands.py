"""COMMAND_LONG and COMMAND_INT for a Crazyflie, as one table: who may, what is done, what is answered."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.crazyflie.modes import Mode, mode_of
from bridge.crazyflie.owner import Right, Sender
from bridge.crazyflie.server.messages import ON_REQUEST, View
from bridge.crazyflie.server.streams import Streams
from bridge.crazyflie.vehicle import Vehicle
from bridge.mavlink.codec.decoding import Message

FORCE = 21196.0  # magic of a forced disarm (MAV_CMD_COMPONENT_ARM_DISARM, param2)
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4  # MAV_RESULT
_INT_FIELDS = ("param1", "param2", "param3", "param4", "x", "y", "z")
_LONG_FIELDS = ("param1", "param2", "param3", "param4", "param5", "param6", "param7")


class Answer(NamedTuple):
    """What became of a command."""

    result: int = ACCEPTED
    reason: str | None = None
    message: Message | None = None  # sent along with the acknowledgement
    later: bool = False  # the supervisor has been asked; acknowledged when it shows


class Command(NamedTuple):
    """One command."""

    params: tuple[float, ...]  # seven
    now_s: float

    def given(self, number: int) -> float | None:
        """Parameter 1 to 7; None when it is NaN, which means "not given"."""
        value = self.params[number - 1]
        return None if math.isnan(value) else value


def read_command(message: Any, now_s: float) -> Command:
    """Parameters of either message."""
    fields = _LONG_FIELDS if message.get_type() == "COMMAND_LONG" else _INT_FIELDS
    return Command(tuple(float(getattr(message, name)) for name in fields), now_s)


def _of(reason: str | None) -> Answer:
    return Answer() if reason is None else Answer(REJECTED, reason)


class Commands:
    """The table."""

    def __init__(self, vehicle: Vehicle, streams: Streams) -> None:
        self._vehicle, self._streams = vehicle, streams
        m = dialect
        self._table: dict[int, tuple[Callable[[Command], Answer], Right]] = {
            m.MAV_CMD_COMPONENT_ARM_DISARM: (self._arm_disarm, Right.OWNER),
            m.MAV_CMD_NAV_TAKEOFF: (self._take_off, Right.OWNER),
            m.MAV_CMD_NAV_LAND: (self._land, Right.ANYBODY),
            m.MAV_CMD_DO_SET_MODE: (self._set_mode, Right.OWNER),
            m.MAV_CMD_DO_FLIGHTTERMINATION: (self._terminate, Right.OWNER_OR_GROUND),
            m.MAV_CMD_REQUEST_MESSAGE: (self._request_message, Right.ANYBODY),
            m.MAV_CMD_SET_MESSAGE_INTERVAL: (self._set_interval, Right.ANYBODY),
            m.MAV_CMD_GET_MESSAGE_INTERVAL: (self._get_interval, Right.ANYBODY),
            m.MAV_CMD_GET_HOME_POSITION: (self._home, Right.ANYBODY),
            m.MAV_CMD_RUN_PREARM_CHECKS: (self._checks, Right.ANYBODY),
        }

    def run(self, number: int, command: Command, sender: Sender) -> Answer:
        """Do it, or say why not."""
        if not all(math.isfinite(p) or math.isnan(p) for p in command.params):
            return Answer(DENIED, f"Command {number} refused: a parameter is infinite")
        entry = self._table.get(number)
        if entry is None:
            return Answer(UNSUPPORTED, f"Command {number} is not supported")
        run, right = entry
        forbidden = self._vehicle.forbids(sender, self._right(number, command, right), command.now_s)
        return (
            run(command) if forbidden is None else Answer(REJECTED, f"Command {number} refused: {forbidden}")
        )

    def _right(self, number: int, command: Command, right: Right) -> Right:
        """Motors off is also for ground stations, landing for all, and nobody may starve the owner."""
        if number == dialect.MAV_CMD_COMPONENT_ARM_DISARM and command.given(2) == FORCE:
            return Right.OWNER_OR_GROUND
        if number == dialect.MAV_CMD_DO_SET_MODE and self._mode(command) is Mode.LAND:
            return Right.ANYBODY
        if number == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            id_ = int(command.given(1) or 0.0)
            if self._streams.known(id_) and self._streams.rarer(id_, command.given(2) or 0.0):
                return Right.OWNER
        return right

    def _arm_disarm(self, command: Command) -> Answer:
        arm, force = command.given(1), command.given(2)
        if arm is None or round(arm) not in (0, 1):
            return Answer(UNSUPPORTED, "Arm or disarm? param1 must be 0 or 1")
        if round(arm) == 0:
            return _of(self._vehicle.disarm(command.now_s, force=force == FORCE))
        reason = self._vehicle.arm(command.now_s)  # force skips no check, as with PX4
        return _of(reason) if reason is not None else Answer(later=not self._vehicle.armed)

    def _take_off(self, command: Command) -> Answer:
        return _of(self._vehicle.take_off(command.given(7), command.now_s))

    def _land(self, command: Command) -> Answer:
        self._vehicle.land(command.now_s)
        return Answer()

    def _mode(self, command: Command) -> Mode | None:
        main, sub = command.given(2), command.given(3)
        custom = int(command.given(1) or 0.0) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        return None if main is None or not custom else mode_of(round(main), round(sub or 0.0))

    def _set_mode(self, command: Command) -> Answer:
        mode = self._mode(command)
        if mode is None:
            known = ", ".join(m.value for m in Mode)
            return Answer(DENIED, f"Mode refused: only PX4's {known}")
        return _of(self._vehicle.set_mode(mode, command.now_s))

    def _terminate(self, command: Command) -> Answer:
        if not (command.given(1) or 0.0) > 0.5:
            return Answer(DENIED, "Termination refused: param1 must be 1")
        self._vehicle.emergency_stop(command.now_s)
        return Answer()

    def _request_message(self, command: Command) -> Answer:
        return self._give(int(command.given(1) or 0.0), command.now_s)

    def _home(self, command: Command) -> Answer:
        return self._give(dialect.MAVLINK_MSG_ID_HOME_POSITION, command.now_s)

    def _give(self, id_: int, now_s: float) -> Answer:
        build, state = ON_REQUEST.get(id_), self._vehicle.state
        if build is None:  # QGroundControl takes ACCEPTED as a promise and waits for the message for ever
            return Answer(DENIED, f"Message {id_} refused: there is none")
        if state is None or not self._vehicle.alive(now_s):
            return Answer(REJECTED, f"Message {id_} refused: the Crazyflie is not heard")
        return Answer(message=build(View(self._vehicle, state, now_s)))

    def _set_interval(self, command: Command) -> Answer:
        id_ = int(command.given(1) or 0.0)
        if not self._streams.known(id_):
            return Answer(FAILED, f"Message {id_} has no rate to set")
        self._streams.set_interval(id_, command.given(2) or 0.0)
        return Answer()

    def _get_interval(self, command: Command) -> Answer:
        id_ = int(command.given(1) or 0.0)
        if not self._streams.known(id_):
            return Answer(FAILED, f"Message {id_} has no rate")
        return Answer(message=dialect.MAVLink_message_interval_message(id_, self._streams.interval_us(id_)))

    def _checks(self, command: Command) -> Answer:
        if self._vehicle.armed:
            return Answer(REJECTED, "Checks refused: armed")
        for problem in self._vehicle.problems(command.now_s):
            self._vehicle.texts.refuse(f"Preflight fail: {problem}", command.now_s)
        return Answer()
