"""Commands that every vehicle has: arming, modes, take-off, landing, and requests for messages.

Results are those of PX4's ``Commander.cpp``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Generic

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.server.commands import (
    DENIED,
    FAILED,
    REJECTED,
    UNSUPPORTED,
    Answer,
    Command,
    Entry,
    answer,
    integer,
)
from bridge.mavlink.server.owner import Right
from bridge.mavlink.server.profile import FlightMode, ServerProfile
from bridge.mavlink.server.streams import Streams
from bridge.mavlink.server.telemetry import Builder, Snapshot, V

FORCE = 21196.0  # magic of a forced disarm (MAV_CMD_COMPONENT_ARM_DISARM, param2)
_CUSTOM_MODE = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


class VehicleCommands(Generic[V]):
    """Handlers of the commands.

    Attributes:
        table: MAV_CMD to handler.
    """

    def __init__(
        self,
        vehicle: V,
        profile: ServerProfile,
        streams: Streams[V],
        builders: Mapping[int, Builder[V]],
        snapshot: Callable[[float], Snapshot[V] | None],
    ) -> None:
        """Set up.

        Args:
            vehicle: the vehicle.
            profile: which autopilot it plays.
            streams: rates of its telemetry.
            builders: messages that can be asked for, by id.
            snapshot: gives its state at a time; None: not known.
        """
        self._vehicle, self._profile, self._streams = vehicle, profile, streams
        self._builders, self._snapshot = builders, snapshot
        m, anybody, owner = dialect, Right.ANYBODY, Right.OWNER
        self.table: dict[int, Entry] = {
            m.MAV_CMD_NAV_LAND: Entry(self._land, anybody),
            m.MAV_CMD_NAV_TAKEOFF: Entry(self._take_off, owner, place=True),
            m.MAV_CMD_DO_SET_MODE: Entry(self._set_mode, owner, right_of=self._right_to_mode),
            m.MAV_CMD_COMPONENT_ARM_DISARM: Entry(self._arm_disarm, owner, right_of=_right_to_arm),
            m.MAV_CMD_RUN_PREARM_CHECKS: Entry(self._prearm_checks, anybody),
            m.MAV_CMD_GET_HOME_POSITION: Entry(self._home, anybody),
            m.MAV_CMD_GET_MESSAGE_INTERVAL: Entry(self._get_interval, anybody),
            m.MAV_CMD_SET_MESSAGE_INTERVAL: Entry(
                self._set_interval, anybody, right_of=self._right_to_interval
            ),
            m.MAV_CMD_REQUEST_MESSAGE: Entry(self._request_message, anybody),
            m.MAV_CMD_REQUEST_PROTOCOL_VERSION: Entry(_protocol_version, anybody),
            m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: Entry(self._capabilities, anybody),
            m.MAV_CMD_REQUEST_CAMERA_INFORMATION: Entry(_camera, anybody),
        }

    def _arm_disarm(self, command: Command) -> Answer:
        arm, force = command.given(1), command.given(2)
        if arm is None or round(arm) not in (0, 1):
            return Answer(UNSUPPORTED, "Arm or disarm? param1 must be 0 or 1")
        if round(arm) == 0:
            return answer(self._vehicle.disarm(command.now_s, force=force == FORCE))
        reason = self._vehicle.arm(command.now_s)  # force skips no check, as with PX4
        return answer(reason) if reason is not None else Answer(later=self._vehicle.arming)

    def _take_off(self, command: Command) -> Answer:
        height_m = command.given(7)
        if self._profile.guided and not command.above_home:
            return Answer(DENIED, "Take-off refused: the height must be above home")
        z_m = None if height_m is None else command.local_z_m(height_m, self._vehicle.home_enu_m)
        return answer(self._vehicle.take_off(z_m, command.now_s))

    def _land(self, command: Command) -> Answer:
        self._vehicle.land(command.now_s)
        return Answer()

    def _set_mode(self, command: Command) -> Answer:
        base, main, sub = command.given(1) or 0.0, command.given(2), command.given(3) or 0.0
        if not int(base) & _CUSTOM_MODE or main is None:
            return Answer(DENIED, "Mode refused: only custom modes")
        mode = self._profile.mode_of(round(main), round(sub))
        if mode is None:
            # ArduPilot: FAILED, as for a mode it cannot enter now
            result = REJECTED if self._profile.guided else DENIED
            return Answer(result, self._profile.why_no_mode(round(main), round(sub)))
        return answer(self._vehicle.set_mode(mode, command.now_s))

    def _right_to_mode(self, command: Command) -> Right:
        main, sub = command.given(2), command.given(3) or 0.0
        landing = main is not None and self._profile.mode_of(round(main), round(sub)) is FlightMode.LAND
        return Right.ANYBODY if landing else Right.OWNER

    def _prearm_checks(self, command: Command) -> Answer:
        if self._vehicle.armed:
            return Answer(REJECTED, "Checks refused: armed")
        for problem in self._vehicle.problems(command.now_s):
            self._vehicle.texts.refuse(f"Preflight fail: {problem}", command.now_s)
        return Answer()

    def _set_interval(self, command: Command) -> Answer:
        message_id, interval_us = integer(command.given(1)), command.given(2) or 0.0
        if message_id is None or not self._streams.known(message_id):
            return _no_stream(message_id)
        self._streams.set_interval(message_id, interval_us, command.now_s)
        return Answer()

    def _right_to_interval(self, command: Command) -> Right:
        """The rates are one table for all: no other sender may lower those of the owner of control."""
        message_id = integer(command.given(1))
        if message_id is None or not self._streams.known(message_id):
            return Right.ANYBODY
        rarer = self._streams.rarer(message_id, command.given(2) or 0.0)
        return Right.OWNER if rarer else Right.ANYBODY

    def _get_interval(self, command: Command) -> Answer:
        message_id = integer(command.given(1))
        if message_id is None or not self._streams.known(message_id):
            return _no_stream(message_id)
        interval_us = self._streams.interval_us(message_id)
        return Answer(messages=(dialect.MAVLink_message_interval_message(message_id, interval_us),))

    def _request_message(self, command: Command) -> Answer:
        return self._give(integer(command.given(1)), command.now_s)

    def _capabilities(self, command: Command) -> Answer:
        if command.given(1) != 1.0:
            return Answer(DENIED, "Capabilities refused: param1 must be 1")
        return self._give(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, command.now_s)

    def _home(self, command: Command) -> Answer:
        return self._give(dialect.MAVLINK_MSG_ID_HOME_POSITION, command.now_s)

    def _give(self, message_id: int | None, now_s: float) -> Answer:
        builder = self._builders.get(message_id) if message_id is not None else None
        if builder is None:
            # QGroundControl takes an ACCEPTED as a promise and waits for the message for ever.
            return Answer(DENIED, f"Message {message_id} refused: there is none")
        snapshot = self._snapshot(now_s)
        if snapshot is None:
            return Answer(REJECTED, f"Message {message_id} refused: the state of the vehicle is not known")
        return Answer(messages=(builder(snapshot),))


def _right_to_arm(command: Command) -> Right:
    kill = command.given(1) is not None and round(command.params[0]) == 0 and command.given(2) == FORCE
    return Right.OWNER_OR_GROUND if kill else Right.OWNER


def _no_stream(message_id: int | None) -> Answer:
    return Answer(FAILED, f"Message {message_id} has no rate to set")  # as PX4 does, HEARTBEAT included


def _protocol_version(command: Command) -> Answer:
    del command
    return Answer(UNSUPPORTED, "No PROTOCOL_VERSION: AUTOPILOT_VERSION says MAVLink 2")


def _camera(command: Command) -> Answer:
    del command
    return Answer(UNSUPPORTED, "No camera")
