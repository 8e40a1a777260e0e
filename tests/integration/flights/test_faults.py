"""Whole runs in which something fails, over the real wires: none hangs, each ends as it must and says why."""

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mav

from logs.reader.flight import load_flight
from tests.integration.runs import called, flightstack, fly
from tests.integration.sim_processes import NAN, Client, is_a, process, terminate

ARMED = 128
LAND = 0x06040000


def events(folder, *words):
    """Texts of the log that hold one of these words, in order of time; the companion's echoes left out."""
    flight = load_flight(folder / "flight.mcap")
    told = [e.text for e in flight.events if e.source != "onboard"]
    return [text for text in told if any(word in text for word in words)]


def test_a_dead_motor_ends_in_a_declared_crash(flown):
    result = flown("fault_motor_dead")
    assert result.code == 1, result.err
    assert result.json["outcome"] == "crashed"
    told = events(result.folder, "Fault", "tumbled", "ABORT")
    assert told[0] == "Fault: motor 2 dead"
    assert any("-> ABORT: the vehicle does not fly what it is told" in text for text in told)
    truth = load_flight(result.log).truth
    assert not truth.motors_running[-1]


def test_motion_capture_frozen_for_half_a_second_is_borne(tmp_path):
    result = fly(tmp_path, "fault_estimate_stuck")
    assert result.code == 0, (result.out, result.err)
    assert result.json["outcome"] == "landed"
    assert result.json["touchdown_error_m"] < 0.08
    assert events(tmp_path, "Fault") == ["Fault: mocap stuck", "Fault over: mocap stuck"]


def test_the_log_says_when_the_robot_was_out_of_sight_and_what_came_of_it(flown):
    result = flown("fault_target_dropout")
    assert (result.code, result.json["outcome"]) == (0, "landed"), result.err
    assert result.json["touchdown_error_m"] < 0.08
    told = events(result.folder, "Fault", "target")
    assert told[0] == "Fault: target odometry off"
    assert told[1].startswith("APPROACH -> HOLD: target lost: the target's newest sample is 0.")
    assert any(text.startswith("HOLD -> CLIMB: target stayed lost") for text in told)
    assert "CLIMB -> APPROACH: target back" in told
    assert told.count("Fault over: target odometry off") == 2


def test_a_clock_that_stands_still_is_an_own_state_lost_and_a_declared_abort(tmp_path):
    result = fly(tmp_path, "fault_clock_stuck")
    assert result.code == 1, result.err
    assert result.json["outcome"] == "aborted"
    told = events(tmp_path, "Fault", "->")
    lost = next(n for n, text in enumerate(told) if text.startswith("APPROACH -> HOLD: own state lost"))
    assert told.index("Fault: clock stuck") < lost


def test_a_vehicle_without_a_heartbeat_is_given_up(tmp_path):
    shown = flightstack("scenarios", "fault_clock_stuck").out
    scenario = tmp_path / "heartbeat_off.toml"
    scenario.write_text(shown.replace('what = "clock"\nkind = "stuck"', 'what = "heartbeat"\nkind = "off"'))
    result = fly(tmp_path / "out", scenario)
    assert result.json["outcome"] == "aborted", result.err
    told = events(tmp_path / "out", "Fault", "->")
    assert "Fault: heartbeat off" in told
    assert any(text.startswith("APPROACH -> HOLD: heartbeat lost") for text in told)
    assert any("-> ABORT" in text for text in told)


def test_failing_runs_repeat_bit_by_bit(flown, tmp_path):
    first, second = flown("fault_link_burst"), fly(tmp_path, "fault_link_burst")
    assert first.json["outcome"] == second.json["outcome"] in ("landed", "aborted"), second.err
    assert events(first.folder, "Fault: link in burst loss")
    same = flightstack("compare", first.log, tmp_path / "flight.mcap")
    assert (same.code, same.out.strip().splitlines()[-1]) == (0, "equal"), same.out
    assert flightstack("compare", first.log, flown("fault_link_burst", 1).log).code == 1


def test_a_wrong_fault_is_refused_before_anything_starts(tmp_path):
    shown = flightstack("scenarios", "fault_motor_dead").out
    (tmp_path / "s.toml").write_text(shown.replace("motor = 2", "motor = 7"))
    result = called("sitl", "--scenario", tmp_path / "s.toml", "--out", tmp_path / "out")
    assert result.code == 2
    assert "fault[0]: motor: found 7, allowed: 1 to 4" in result.err


def set_parameter(name: str, value: int):
    raw = struct.unpack("<f", struct.pack("<i", value))[0]  # PX4 carries integers bytewise
    return mav.MAVLink_param_set_message(1, 1, name.encode(), raw, mav.MAV_PARAM_TYPE_INT32)


def inject(client: Client, unit: int, kind: int, instance: int = 0) -> int:
    """Send MAV_CMD_INJECT_FAILURE; the result."""
    client.send(client.command(420, float(unit), float(kind), float(instance)))
    return int(client.until(is_a("COMMAND_ACK", command=420)).result)


def test_failures_can_be_injected_and_healed_over_mavlink():
    gps, motor, link, off, ok = 4, 101, 105, 1, 0
    with process("vehicle", seed=1, url="udpin:127.0.0.1:0") as (child, ready):
        client = Client(ready.removeprefix("ready "))
        client.hello()
        client.until(is_a("HEARTBEAT"))
        assert inject(client, motor, off, 1) == mav.MAV_RESULT_DENIED  # SYS_FAILURE_EN is 0
        client.send(set_parameter("SYS_FAILURE_EN", 1))
        client.until(is_a("PARAM_VALUE"))
        assert inject(client, 0, off) == mav.MAV_RESULT_UNSUPPORTED  # no gyro failures here

        client.send(client.command(400, 1.0), client.command(22, NAN, NAN, NAN, NAN, NAN, NAN, NAN))
        client.until(lambda m: is_a("HEARTBEAT")(m) and m.base_mode & ARMED)
        client.until(lambda m: is_a("LOCAL_POSITION_NED")(m) and m.z < -0.4)

        assert inject(client, link, off) == mav.MAV_RESULT_ACCEPTED
        while client.receive(0.5):  # until the wire is silent; what was under way still comes
            pass
        client.log.clear()
        assert client.receive(0.5) == []
        assert inject(client, link, ok) == mav.MAV_RESULT_ACCEPTED
        client.until(is_a("LOCAL_POSITION_NED"))

        assert inject(client, gps, off) == mav.MAV_RESULT_ACCEPTED
        client.until(is_a("STATUSTEXT", text="Fault: mocap off"))
        client.until(lambda m: is_a("HEARTBEAT")(m) and m.custom_mode == LAND)
        client.until(lambda m: is_a("HEARTBEAT")(m) and not m.base_mode & ARMED)
        assert inject(client, gps, ok) == mav.MAV_RESULT_ACCEPTED
        client.until(is_a("STATUSTEXT", text="Fault over: mocap off"))
        position = client.until(is_a("LOCAL_POSITION_NED"))
        assert math.isfinite(position.z)
        assert terminate(child) < 2.0
