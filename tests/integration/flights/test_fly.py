"""Tests ``flightstack fly`` with external vehicle and target, and the messages during the wait for both."""

from __future__ import annotations

import re
import signal
import subprocess
from contextlib import contextmanager

import pytest

from bridge.zenoh import zenoh_link
from logs.reader.flight import load_flight
from logs.reader.reader import LogFile
from tests.flight_suite.room import simulated
from tests.integration.runs import COMMAND, WALL_MAX_S, Background, called, flightstack, replayed
from tests.integration.sim_processes import ROOT
from tests.processes.bounded import killed, lines_of, wait_for
from tests.processes.ports import free_endpoint, free_port
from tests.unit.target import ros2_helpers as ros

pytestmark = pytest.mark.xdist_group("real-time")


@contextmanager
def theirs(folder):
    """Run vehicle and robot as separate processes; yield the options of ``fly`` for both."""
    with simulated(folder) as room:
        yield [
            "--vehicle", room.url, "--target", room.target_key, "--connect", *room.connect,
            "--listen", room.listen, "--config", str(room.config), "--target-offset", "0", "0", "0",
        ]  # fmt: skip


def test_lands_records_judges_and_reports(tmp_path):
    with theirs(tmp_path) as words:
        done = flightstack("fly", *words, "--core", "compiled", "--out", tmp_path / "flight", "--json")
    assert done.code == 0, done.err
    found = done.json
    assert LogFile(found["log"]).single().metadata()["onboard"]["core"] == "compiled"
    assert replayed(found["log"])["compared"] > 500  # number of replayed ticks
    assert found["outcome"] == "landed"
    assert found["judged_from"] == "estimate"
    assert found["touchdown_error_m"] <= 0.10
    assert found["config"] == "onboard"
    flight = load_flight(found["log"])
    assert flight.complete
    assert flight.truth is None
    assert flight.metadata["run"]["vehicle"] == words[1]
    assert flight.pad_radius_m == 0.1
    assert (flight.metadata["preflight"]["profile"], flight.metadata["preflight"]["problem"]) == ("sitl", "")
    assert not any("UNSAFE" in value for value in flight.metadata["preflight"].values())
    assert (tmp_path / "flight" / "report.html").stat().st_size > 100_000


def test_a_reader_that_ends_changes_nothing_and_sigterm_commands_the_landing(tmp_path):
    out = tmp_path / "flight"
    with theirs(tmp_path) as words:
        run = subprocess.Popen(
            [*COMMAND, "fly", *words, "--out", str(out), "--no-report"], stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            for line in lines_of(run.stdout, WALL_MAX_S):
                if "-> TAKEOFF" in line:
                    run.stdout.close()
                    break
            log = out / "flight.mcap"
            wait_for(lambda: b"TAKEOFF -> APPROACH" in log.read_bytes(), "the approach")
            run.send_signal(signal.SIGTERM)
            assert run.wait(WALL_MAX_S) == 1
        finally:
            killed(run)
    flight = load_flight(log)
    assert flight.complete
    assert any("(land here)" in event.text for event in flight.events)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--vehicle", "udpin:0.0.0.0:0", "--config", "crazyflie"), "--signing-key FILE"),
        (("--vehicle", "udpout:127.0.0.1:9", "--config", "nowhere"), "px4"),
    ],
)
def test_wrong_input_is_status_2_with_what_to_do(tmp_path, words, said):
    done = called("fly", *words, "--out", tmp_path / "flight")
    assert done.code == 2
    assert said in done.err


def test_without_a_heartbeat_the_result_is_the_reason_alone(tmp_path):
    done = called(
        "fly", "--vehicle", "udpout:127.0.0.1:9", "--config", "crazyflie", "--duration", "1", "--out",
        tmp_path / "flight",
    )  # fmt: skip
    assert done.code == 1
    assert "no heartbeat of system 1" in " ".join(done.out.split())
    assert done.err == ""


def test_onboard_alone_records_unless_declined(tmp_path):
    words = ["onboard", "--vehicle", "udpout:127.0.0.1:9", "--config", "crazyflie", "--duration", "1"]
    done = flightstack(*words, cwd=tmp_path)
    assert done.code == 1
    (log,) = tmp_path.glob("runs/*/flight.mcap")
    assert f"log {log.relative_to(tmp_path)}" in done.out
    declined = tmp_path / "declined"
    declined.mkdir()
    assert flightstack(*words, "--no-record", cwd=declined).code == 1
    assert not list(declined.iterdir())


TARGET = "cf1/target/odom"
STAMP_NS = 1_700_000_000_000_000_000


def config(folder, wait_s):
    """Write the package's configuration ``crazyflie`` with this ``wait_time_max_s``; return its path."""
    text, n = re.subn(
        r"^wait_time_max_s = .*$", f"wait_time_max_s = {wait_s:.1f}",
        (ROOT / "flightstack" / "config" / "crazyflie.toml").read_text(), flags=re.MULTILINE,
    )  # fmt: skip
    assert n == 1
    file = folder / "onboard.toml"
    file.write_text(text)
    return file


@pytest.fixture
def start():
    started = []

    def begin(*arguments):
        started.append(Background(*arguments))
        return started[-1]

    yield begin
    for process in started:
        process.kill()


@pytest.fixture
def port():
    return free_port(udp=True)


def onboard(start, port, folder, wait_s, *more):
    words = ("--target", TARGET, "--config", config(folder, wait_s), "--no-record")
    return start("onboard", "--vehicle", f"udpin:127.0.0.1:{port}", *words, *more)


def test_a_target_on_another_key_then_in_another_frame_then_a_vehicle_that_dies(start, tmp_path):
    log, socket, endpoint = tmp_path / "wait.mcap", tmp_path / "socket", free_endpoint()
    recorder = start("record", "--socket", socket, "--out", log)
    recorder.until("ready")
    vehicle = start("vehicle", "--scenario", "paper_moving_1", "--url", "udpin:127.0.0.1:0")
    url = vehicle.until("ready").split()[1].replace("udpin", "udpout")
    words = ("--target", TARGET, "--config", config(tmp_path, 30.0), "--listen", endpoint)
    waits = start("onboard", "--vehicle", url, *words, "--recorder", socket)
    robot = zenoh_link.open_session(connect=[endpoint])
    elsewhere = zenoh_link.dropping_publisher(robot, "robot7/odom")
    here = zenoh_link.dropping_publisher(robot, TARGET)
    line = waits.until(
        f"no sample on {TARGET}; there are robot7/odom", each=lambda: elsewhere.put(b"odometry")
    )
    assert "s (checks.wait_time_max_s)" in line
    wrong = ros.odometry(STAMP_NS, "odom", "base_footprint")
    waits.until(
        "none accepted", "frame_id is 'odom', checks.target_frame is 'map'", each=lambda: here.put(wrong)
    )
    robot.close()
    vehicle.kill()
    waits.until("no heartbeat of system 1, component 1 for", "no data arrives", "gives up within")
    assert waits.end() == 1
    last = waits.lines[-1]
    assert last.startswith("ABORT: inputs did not become ready in time: the vehicle's newest state is ")
    assert re.search(r"the newest heartbeat is [\d.]+ s old; checks.status_age_max_s is 3", last)
    assert ": no heartbeat of system 1, component 1 for" in last
    assert f"; the newest sample on {TARGET} is" in last or f"; no sample on {TARGET}" in last
    assert recorder.end(signal.SIGTERM) == 0
    found = [text for text in messages(log) if text.startswith("waiting: ")]
    assert any("there are robot7/odom" in text for text in found)
    assert any("no heartbeat of system 1" in text for text in found)


def messages(log):
    """Return the texts of /rosout in a log."""
    from logs.schema.rows import LogRow

    return [LogRow.unpack(message.data).msg for message in LogFile(log).messages({"/rosout"})]
