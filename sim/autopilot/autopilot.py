"""The MAVLink autopilot of the simulated vehicle, which behaves like PX4.

The autopilot is pure: it computes messages from messages and times, without socket, clock or random numbers.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.commander import Right, Sender
from bridge.mavlink.server.commands import DENIED, UNSUPPORTED, Answer, Command, Entry, answer, integer
from bridge.mavlink.server.parameters import REAL32, Parameter, Parameters, fixed, one_of, real
from bridge.mavlink.server.profile import FlightMode
from bridge.mavlink.server.server import SYSTEM_ID, Handler, Server
from bridge.mavlink.server.telemetry import Snapshot
from sim.autopilot.flight import Flight
from sim.autopilot.telemetry import STREAMS, degrees_e7
from sim.vehicle.vehicle import VehicleSim

_CHANGE_MODE = 1  # MAV_DO_REPOSITION_FLAGS_CHANGE_MODE


class Autopilot(Server[Flight]):
    """MAVLink interface of one simulated vehicle: PX4's modes, commands and telemetry.

    Call at each tick: ``telemetry``, ``handle`` for each message, ``control``, the physics.
    """

    def __init__(
        self, vehicle: VehicleSim, rate_hz: float, *, system_id: int = SYSTEM_ID, epoch_ns: int = 0
    ) -> None:
        """Start the autopilot, in HOLD if the vehicle flies. ``epoch_ns``: Unix time at simulated time 0."""
        parameters = Parameters(px4_parameters(system_id))
        self.flight = Flight(vehicle, parameters, 1.0 / rate_hz)
        self._epoch_ns = epoch_ns
        super().__init__(self.flight, STREAMS, parameters, rate_hz, system_id=system_id)

    def control(self, now_s: float) -> None:
        """Compute the set-point; call it after ``handle`` and before the physics."""
        self.flight.control(now_s)

    def snapshot(self, now_s: float) -> Snapshot[Flight]:
        """Return the state of the vehicle; the boot clock is the simulated time."""
        estimate = self.flight.vehicle.estimate()
        return Snapshot(self.flight, estimate, estimate.valid, now_s, now_s, self._epoch_ns)

    def own_commands(self) -> dict[int, Entry]:
        m, owner = dialect, Right.OWNER
        return {
            m.MAV_CMD_DO_REPOSITION: Entry(self._pause, owner, place=True),
            m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: Entry(self._reboot, owner),
        }

    def own_handlers(self) -> dict[int, Handler]:
        return {dialect.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._set_origin}

    def condition(self, snapshot: Snapshot[Flight]) -> object:
        return super().condition(snapshot), self.flight.vehicle.locked

    def _set_origin(self, _message: Any, _sender: Sender, now_s: float) -> list[Message]:
        self.flight.texts.refuse("Origin refused: the simulated room does not move", now_s)
        return [dialect.MAVLink_gps_global_origin_message(*degrees_e7(0.0, 0.0), 0, round(now_s * 1e6))]

    # Commands of this autopilot only, with PX4's results (Commander.cpp)

    def _pause(self, command: Command) -> Answer:
        """Hold the present position: QGroundControl pauses by a reposition without coordinates."""
        if integer(command.given(2)) != _CHANGE_MODE:
            return Answer(UNSUPPORTED, "Reposition refused: only with flag 1, change mode")
        if any(command.given(number) is not None for number in (5, 6, 7)):
            return Answer(UNSUPPORTED, "Reposition refused: only without a place, to hold the present one")
        return answer(self.flight.set_mode(FlightMode.HOLD, command.now_s))

    def _reboot(self, command: Command) -> Answer:
        what = integer(command.given(1))
        if what == 0:
            return Answer()  # accept value 0, "do nothing", for example if only the companion restarts
        if what != 1:
            return Answer(DENIED, "Reboot refused: param1 must be 1, nothing else can be done")
        reason = self.flight.reboot(command.now_s)
        if reason is None:
            self.streams.reset(command.now_s)
        return answer(reason, DENIED)


# Parameters have PX4's names, units and values. Fixed parameters describe the simulator or have no effect.
# QGroundControl requires these parameters, which have no effect (PX4 mavlink_parameters.cpp, send()).
_FOR_QGROUNDCONTROL = (
    *(fixed(f"CAL_MAG{i}_{kind}", 0) for i in range(4) for kind in ("ID", "ROT")),
    *(fixed(name, 0) for name in ("CAL_ACC0_ID", "CAL_GYRO0_ID", "SENS_BOARD_ROT", "TRIG_MODE")),
    *(fixed(name, 0) for name in ("UAVCAN_ENABLE", "SYS_AUTOSTART")),
    *(
        Parameter(name, REAL32, 0.0, 0.0, 0.0)
        for name in ("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF", "SENS_DPRES_OFF")
    ),
    fixed("SYS_PARAM_VER", 1),
)

# A table in sim.autopilot.flight maps the values of COM_OBL_RC_ACT to modes.
_OWN = (
    real("COM_OF_LOSS_T", 0.5, 0.1, 5.0),  # time without a set-point before COM_OBL_RC_ACT applies, s
    one_of("COM_OBL_RC_ACT", 4, 0, 4, 5),  # action on lost set-points: 0 and 4 land, 5 holds
    real("COM_DISARM_LAND", 2.0, 0.1, 20.0),  # time on the ground until disarming, s; PX4's default
    real("COM_DISARM_PRFLT", 10.0, 1.0, 120.0),  # time without take-off until disarming, s; PX4's default
    fixed("COM_RC_IN_MODE", 4),  # there is no stick input
    fixed("MAN_OVERRIDE_SPD", -1.0, REAL32),  # stick input never overrides
    fixed("COM_LOW_BAT_ACT", 0),  # a low battery causes no action
    fixed("NAV_DLL_ACT", 0),  # a lost ground station causes no action
    real("BAT1_V_EMPTY", 3.5, 2.5, 4.0),  # voltage of the empty cell at rest, V
    real("BAT1_V_CHARGED", 4.15, 3.5, 4.35),  # voltage of the full cell at rest, V
    real("BAT1_V_LOAD_DROP", 0.37, 0.0, 1.0),  # voltage drop at full throttle, V; in hover (0.67) 0.25 V
    fixed("GF_ACTION", 0),  # there is no fence
    fixed("GF_MAX_HOR_DIST", 0.0, REAL32),
    fixed("GF_MAX_VER_DIST", 0.0, REAL32),
    fixed("SYS_FAILURE_EN", 0),  # command 420 (MAV_CMD_INJECT_FAILURE) is not available
    real("MIS_TAKEOFF_ALT", 0.5, 0.1, 20.0, in_flight=True),  # height above the take-off position, m
    real("MPC_TKO_SPEED", 0.5, 0.1, 1.0, in_flight=True),  # climb speed of the take-off, m/s
    real("MPC_LAND_SPEED", 0.3, 0.1, 0.8, in_flight=True),  # sink speed of the landing, m/s
    real("MPC_XY_CRUISE", 0.5, 0.1, 2.0, in_flight=True),  # maximum speed in the autopilot's modes, m/s
    # Limits to which set-points are clipped, m/s. The defaults have no effect: set-points above 5 m/s are
    # rejected.
    real("MPC_XY_VEL_MAX", 5.0, 0.1, 20.0),
    real("MPC_Z_VEL_MAX_UP", 5.0, 0.1, 8.0),
    real("MPC_Z_VEL_MAX_DN", 5.0, 0.1, 8.0),
    real("MPC_XY_P", 1.0, 0.1, 2.0, in_flight=True),  # gain of the horizontal position loop, 1/s
    real("MPC_Z_P", 1.0, 0.1, 1.5, in_flight=True),  # gain of the height loop, 1/s
    fixed("MAV_COMP_ID", dialect.MAV_COMP_ID_AUTOPILOT1),
    fixed("MAV_TYPE", dialect.MAV_TYPE_QUADROTOR),
)


def px4_parameters(system_id: int) -> tuple[Parameter, ...]:
    all_ = (*_OWN, *_FOR_QGROUNDCONTROL, fixed("MAV_SYS_ID", system_id))
    return tuple(sorted(all_, key=lambda parameter: parameter.name))
