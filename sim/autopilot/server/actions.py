"""Commands that do something to the vehicle, with PX4's results (PX4 Commander.cpp)."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import yaw_enu_from_ned
from flightstack.core.types import Vec3
from sim.autopilot.flight import Flight
from sim.autopilot.geo import x_of, y_of
from sim.autopilot.modes import FlightMode
from sim.autopilot.owner import Right
from sim.autopilot.parameters import Parameters
from sim.autopilot.pilot import Goal
from sim.autopilot.server.commands import (
    DENIED,
    REJECTED,
    UNSUPPORTED,
    Answer,
    Command,
    Entry,
    Table,
    answer,
    integer,
)
from sim.autopilot.server.streams import Streams

FORCE = 21196.0  # magic of a forced disarm (MAV_CMD_COMPONENT_ARM_DISARM, param2)
_CUSTOM_MODE = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_CHANGE_MODE = 1  # MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
_UNITS = dialect.enums["FAILURE_UNIT"]
_KINDS = dialect.enums["FAILURE_TYPE"]


class Actions:
    """Handlers of the commands that act."""

    def __init__(self, flight: Flight, parameters: Parameters, streams: Streams) -> None:
        self._flight = flight
        self._parameters = parameters
        self._streams = streams
        m, owner = dialect, Right.OWNER
        self.table: Table = {
            m.MAV_CMD_NAV_RETURN_TO_LAUNCH: Entry(self._return, owner),
            m.MAV_CMD_NAV_LAND: Entry(self._land, Right.ANYBODY),
            m.MAV_CMD_NAV_TAKEOFF: Entry(self._take_off, owner, place=True),
            m.MAV_CMD_DO_SET_MODE: Entry(self._set_mode, owner, right_of=self._right_to_mode),
            m.MAV_CMD_DO_SET_HOME: Entry(self._set_home, owner, place=True),
            m.MAV_CMD_DO_FLIGHTTERMINATION: Entry(self._terminate, Right.OWNER_OR_GROUND),
            m.MAV_CMD_DO_REPOSITION: Entry(self._reposition, owner, place=True),
            m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: Entry(self._reboot, owner),
            m.MAV_CMD_COMPONENT_ARM_DISARM: Entry(self._arm_disarm, owner, right_of=_right_to_arm),
            m.MAV_CMD_RUN_PREARM_CHECKS: Entry(self._prearm_checks, Right.ANYBODY),
            m.MAV_CMD_INJECT_FAILURE: Entry(self._inject_failure, owner),
        }

    def _arm_disarm(self, command: Command) -> Answer:
        arm, force = command.given(1), command.given(2)
        if arm is None or round(arm) not in (0, 1):
            return Answer(UNSUPPORTED, "Arm or disarm? param1 must be 0 or 1")
        if round(arm) == 1:
            return answer(self._flight.arm(command.now_s))  # force does not skip checks, as with PX4
        return answer(self._flight.disarm(force=force == FORCE))

    def _take_off(self, command: Command) -> Answer:
        height_m = command.given(7)
        if self._flight.personality.guided and not command.above_home:
            return Answer(DENIED, "Take-off refused: the height must be above home")
        return answer(self._flight.take_off(None if height_m is None else self._local_z(command, height_m)))

    def _land(self, command: Command) -> Answer:
        del command
        self._flight.land()
        return Answer()

    def _return(self, command: Command) -> Answer:
        return answer(self._flight.set_mode(FlightMode.RETURN, command.now_s))

    def _set_mode(self, command: Command) -> Answer:
        base, main, sub = command.given(1) or 0.0, command.given(2), command.given(3) or 0.0
        if not int(base) & _CUSTOM_MODE or main is None:
            return Answer(DENIED, "Mode refused: only custom modes")
        who = self._flight.personality
        mode = who.mode_of(round(main), round(sub))
        if mode is None:
            # ArduPilot: FAILED, as for a mode it cannot enter now
            return Answer(REJECTED if who.guided else DENIED, who.why_no_mode(round(main), round(sub)))
        return answer(self._flight.set_mode(mode, command.now_s))

    def _right_to_mode(self, command: Command) -> Right:
        main, sub = command.given(2), command.given(3) or 0.0
        mode_of = self._flight.personality.mode_of
        landing = main is not None and mode_of(round(main), round(sub)) is FlightMode.LAND
        return Right.ANYBODY if landing else Right.OWNER

    def _terminate(self, command: Command) -> Answer:
        if not (command.given(1) or 0.0) > 0.5:
            return Answer(DENIED, "Termination refused: param1 must be 1")
        if not self._flight.vehicle.armed:
            return Answer(DENIED, "Termination refused: not armed")
        return answer(self._flight.disarm(force=True))

    def _prearm_checks(self, command: Command) -> Answer:
        if self._flight.vehicle.armed:
            return Answer(REJECTED, "Checks refused: armed")
        for problem in self._flight.problems():
            self._flight.texts.refuse(f"Preflight fail: {problem}", command.now_s)
        return Answer()

    def _set_home(self, command: Command) -> Answer:
        if (command.given(1) or 0.0) > 0.5:
            estimate = self._flight.vehicle.estimate()
            if not estimate.valid:
                return Answer(REJECTED, "Home refused: no position estimate")
            point: Vec3 | None = estimate.position_enu_m
        else:
            point = self._point(command)
        if point is None:
            return Answer(DENIED, "Home refused: latitude, longitude and altitude are needed")
        reason = self._flight.set_home(point)
        if reason is None:
            self._streams.hasten(dialect.MAVLINK_MSG_ID_HOME_POSITION)
        return answer(reason)

    def _reposition(self, command: Command) -> Answer:
        if integer(command.given(2)) != _CHANGE_MODE:
            return Answer(UNSUPPORTED, "Reposition refused: only with flag 1, change mode")
        latitude, longitude, height_m = command.given(5), command.given(6), command.given(7)
        if latitude is None and longitude is None and height_m is None:
            return answer(self._flight.set_mode(FlightMode.HOLD, command.now_s))
        if (latitude is None) != (longitude is None):
            return Answer(DENIED, "Reposition refused: latitude and longitude only together")
        here = self._flight.pilot.goal.point_enu_m if self._flight.pilot.goal else self._here()
        x, y, z = here
        if latitude is not None and longitude is not None:
            x, y = x_of(longitude), y_of(latitude)
        if height_m is not None:
            z = self._local_z(command, height_m)
        yaw, speed_m_s = command.given(4), command.given(1)
        goal = Goal(
            (x, y, z),
            None if yaw is None else yaw_enu_from_ned(yaw),
            speed_m_s if speed_m_s is not None and speed_m_s > 0.0 else None,
        )
        return answer(self._flight.reposition(goal))

    def _reboot(self, command: Command) -> Answer:
        what = integer(command.given(1))
        if what == 0:
            return Answer()  # "do nothing", for example when only the companion shall restart
        if what != 1:
            return Answer(DENIED, "Reboot refused: param1 must be 1, nothing else can be done")
        reason = self._flight.reboot()
        if reason is None:
            self._streams.reset(command.now_s)
        return answer(reason, DENIED)

    def _inject_failure(self, command: Command) -> Answer:
        unit, kind = integer(command.given(1)), integer(command.given(2))
        instance = integer(command.given(3) or 0.0)
        if not self._parameters["SYS_FAILURE_EN"]:
            return Answer(DENIED, "Failure refused: SYS_FAILURE_EN is 0")
        if unit is None or kind is None or instance is None or instance < 0:
            return Answer(DENIED, "Failure refused: unit, type and instance are whole numbers")
        reason = self._flight.vehicle.inject_failure(unit, kind, instance)
        if reason is None:
            text = f"Failure: {_name(_UNITS, unit)} {_name(_KINDS, kind)}"
            self._flight.say(dialect.MAV_SEVERITY_NOTICE, f"{text} {instance}" if instance else text)
            return Answer()
        return Answer(UNSUPPORTED, f"Failure refused: {reason}")

    def _here(self) -> Vec3:
        return self._flight.vehicle.estimate().position_enu_m

    def _local_z(self, command: Command, height_m: float) -> float:
        """Local height; the room's floor is at sea level."""
        return height_m + (self._flight.home_enu_m[2] if command.above_home else 0.0)

    def _point(self, command: Command) -> Vec3 | None:
        latitude, longitude, height_m = command.given(5), command.given(6), command.given(7)
        if latitude is None or longitude is None or height_m is None:
            return None
        return (x_of(longitude), y_of(latitude), self._local_z(command, height_m))


def _right_to_arm(command: Command) -> Right:
    kill = command.given(1) is not None and round(command.params[0]) == 0 and command.given(2) == FORCE
    return Right.OWNER_OR_GROUND if kill else Right.OWNER


def _name(names: dict[int, object], number: int) -> str:
    entry = names.get(number)
    if entry is None:
        return str(number)
    name = str(getattr(entry, "name", number)).removeprefix("FAILURE_UNIT_").removeprefix("FAILURE_TYPE_")
    return name.lower().replace("_", " ")
