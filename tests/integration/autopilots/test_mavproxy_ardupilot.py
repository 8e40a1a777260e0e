"""MAVProxy flies the simulated vehicle as ArduCopter, by the words its manuals teach for one."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from sim.autopilot.ground import degrees_e7
from tests.integration.autopilots.real_clients import ON_GROUND, Observer, vehicle
from tests.integration.autopilots.test_mavproxy import LEG_M, SPEED_M_S, STREAM_S, Repeat, connect, mavproxy

pytestmark = pytest.mark.xdist_group("real-time")

BRAKE, GUIDED, LAND = 17, 4, 9  # ArduCopter mode.h
HEIGHT_M = 0.8


def test_whole_flight(tmp_path: Path) -> None:
    with vehicle(tmp_path, "--profile", "ardupilot") as port:
        watch = Observer(port)
        with mavproxy(port, tmp_path, watch) as program:
            connect(program)
            program.send("param fetch GUID_TIMEOUT")
            program.expect(r"GUID_TIMEOUT = 3\.0")
            program.send("param set DISARM_DELAY 20")
            read = Repeat(program, lambda: "param fetch DISARM_DELAY", 0.5)
            program.expect(r"DISARM_DELAY = 20\.0", each=read)  # decoded as a plain float, as for ArduPilot
            program.send("arm throttle")
            program.expect("AP: Arming refused: no position estimate")
            watch.send(mav.MAVLink_set_gps_global_origin_message(1, *degrees_e7(0.0, 0.0), 0))
            program.expect("AP: EKF origin set")
            program.send("arm throttle")
            program.expect("AP: Arming refused: mode is BRAKE")
            program.send("mode GUIDED")
            program.expect("Mode GUIDED|GUIDED>")
            program.send("arm throttle")
            program.expect("Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
            program.send(f"takeoff {HEIGHT_M}")
            program.expect("Got COMMAND_ACK: NAV_TAKEOFF: ACCEPTED")
            program.until(lambda: height(watch) > 0.9 * HEIGHT_M, "its height")
            west = Repeat(program, lambda: f"velocity {-SPEED_M_S:g} 0 0", STREAM_S)  # it looks east
            start_m = watch.position.y
            program.until(lambda: watch.position.y < start_m - LEG_M, "a leg to the west", each=west)
            assert watch.modes()[-1] == GUIDED
            program.send("mode LAND")
            program.expect("Mode LAND|LAND>")
            program.expect("DISARMED")
            program.until(lambda: watch.last("HEARTBEAT").base_mode & 128 == 0, "its last heartbeat")
        watch.close()
    assert watch.modes() == [BRAKE, GUIDED, LAND]
    assert watch.armings() == [False, True, False]
    assert watch.last("HEARTBEAT").autopilot == 3
    assert watch.last("LOCAL_POSITION_NED").z > -0.1
    found = watch.last("EXTENDED_SYS_STATE")
    assert found is None or found.landed_state == ON_GROUND  # nobody asked for it


def height(watch: Observer) -> float:
    found = watch.last("LOCAL_POSITION_NED")
    return -found.z if found is not None else 0.0
