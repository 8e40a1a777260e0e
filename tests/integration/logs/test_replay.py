"""Whole flights recorded over the real wires, replayed bit by bit, and played back into a running process."""

import json
import os
import pty
import select
import subprocess
import time

import pytest

from flightstack.common.processes import Port
from logs.reader.reader import LogFile
from logs.replay.replay import replay
from tests.golden.flights import path_of
from tests.integration.runs import COMMAND, Flying, flightstack, kill, replayed

DEADLINE_S = 90.0


def test_a_real_time_flight_replays_bit_by_bit_inputs_from_the_wire_included(tmp_path):
    flown = flightstack("sitl", "--scenario", "straight", "--duration", 6, "--no-report", "--out", tmp_path)
    assert flown.code == 1  # out of time on purpose
    found = replayed(tmp_path / "flight.mcap")
    assert "APPROACH" in {change["phase"] for change in found["phases_recorded"]}
    (config,) = [a for a in LogFile(tmp_path / "flight.mcap").attachments() if a.name == "onboard.toml"]
    assert b"alpha_1_m" in config.data


def test_a_log_whose_recorder_was_killed_replays_up_to_the_break(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.wait_for("-> LAND:")
    log = run.some_log(1_200_000)  # so far it is APPROACH, and there is something to replay
    kill(run.children()["record"])
    assert run.end() == 1
    result = replay(log)
    assert result.equal
    assert any("breaks off" in note for note in result.notes)
    assert result.compared > 100


class Lines:
    """A process whose output is read line by line, within a deadline."""

    def __init__(self, *arguments):
        self.process = subprocess.Popen(
            [*COMMAND, *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        self.text = b""

    def wait_for(self, word: str) -> str:
        until = time.monotonic() + DEADLINE_S
        while time.monotonic() < until:
            for line in self.text.decode().splitlines(keepends=True):
                if word in line and line.endswith("\n"):
                    return line.strip()
            if select.select([self.process.stdout], [], [], 0.1)[0]:
                more = os.read(self.process.stdout.fileno(), 65536)
                if not more:
                    break
                self.text += more
        raise AssertionError(f"{word!r} not in {self.text.decode()}")

    def end(self) -> int:
        self.text += self.process.communicate(timeout=DEADLINE_S)[0]
        return self.process.returncode

    def kill(self):
        self.process.kill()
        self.process.communicate()


def test_a_log_played_live_lands_a_running_onboard_process(tmp_path):
    golden, port = path_of("contact"), Port()
    (config,) = [a.data for a in LogFile(golden).attachments() if a.name == "onboard.toml"]
    (tmp_path / "onboard.toml").write_bytes(config)
    socket, log = tmp_path / "s", tmp_path / "again.mcap"
    started = []
    try:
        recorder = Lines("record", "--socket", socket, "--out", log, "--until-clients", 1)
        started.append(recorder)
        recorder.wait_for("ready")
        player = Lines(
            "replay", golden, "--live", "--vehicle-url", "udpin:127.0.0.1:0", "--listen", port.endpoint,
            "--wait", 60,
        )  # fmt: skip
        started.append(player)
        url = player.wait_for("ready").split()[1].replace("udpin", "udpout")
        onboard = Lines(
            "onboard", "--vehicle", url, "--connect", port.endpoint, "--config", tmp_path / "onboard.toml",
            "--recorder", socket, "--duration", 60,
        )  # fmt: skip
        started.append(onboard)
        assert onboard.end() == 0, onboard.text.decode()
        assert player.end() == 0, player.text.decode()
        assert recorder.end() == 0
    finally:
        port.close()
        for each in started:
            each.kill()
    said = onboard.text.decode()
    order = [said.index(f"-> {phase}:") for phase in ("APPROACH", "LAND", "TOUCHDOWN", "LANDED")]
    assert order == sorted(order)
    assert f"played {replay(golden).compared} ticks" in player.text.decode()
    again = replay(log)  # flown by hand with a recorder: everything a replay needs is in that log, too
    assert again.equal, again.outputs.first
    assert again.wire.count == 0
    assert {"LAND", "LANDED"} <= {change.phase for change in again.phases_recorded}
    samples = [m.data for m in LogFile(log).messages({"/cf1/target/odom"})]
    recorded = {m.data for m in LogFile(golden).messages({"/cf1/target/odom"})}
    assert len(samples) > 200
    assert set(samples) <= recorded  # to the byte


def test_the_recorded_decisions_are_shown_to_viewers(tmp_path):
    port = Port()
    player = Lines("replay", path_of("contact"), "--live", "--view", "--listen", port.endpoint, "--rate", 50,
                   "--wait", 60, "--loop", "--duration", 6)  # fmt: skip
    socket, log = tmp_path / "s", tmp_path / "seen.mcap"
    viewer = Lines("record", "--socket", socket, "--out", log, "--connect", port.endpoint, "--key", "cf1/**")
    try:
        player.wait_for("ready")
        assert player.end() == 0, player.text.decode()
        viewer.process.terminate()
        assert viewer.end() == 0, viewer.text.decode()
    finally:
        port.close()
        player.kill()
        viewer.kill()
    seen = {m.topic for m in LogFile(log).messages()}
    assert {"/cf1/controller/step", "/cf1/target/odom"} <= seen
    recorded = sum(m.topic == "/cf1/controller/step" for m in LogFile(path_of("contact")).messages())
    assert sum(m.topic == "/cf1/controller/step" for m in LogFile(log).messages()) > recorded  # it looped


@pytest.mark.parametrize(("keys", "ticks"), [(b"", 0), (b"s", 1), (b"ss", 2), (b"xs\n", None)])
def test_keys_of_a_terminal_step_and_start_a_paused_replay(keys, ticks):
    odometry = LogFile(path_of("contact")).messages({"/cf1/target/odom"})
    whole = len({message.log_time_ns for message in odometry})
    master, slave = pty.openpty()
    command = [
        *COMMAND,
        "replay",
        str(path_of("contact")),
        "--live",
        "--pause",
        "--listen",
        "tcp/127.0.0.1:0",
    ]
    command += ["--wait", "0", "--rate", "100", "--duration", "4"]
    player = subprocess.Popen(command, stdin=slave, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    os.close(slave)
    try:
        assert player.stdout.readline() == b"ready\n"  # from here on keys count
        os.write(master, keys)
        out, _ = player.communicate(timeout=DEADLINE_S)
    finally:
        player.kill()
        os.close(master)
    assert player.returncode == 0, out
    assert f"played {whole if ticks is None else ticks} ticks" in out.decode()


def test_json_of_a_log_that_proves_nothing(tmp_path):
    flown = flightstack(
        "sitl",
        "--scenario",
        "paper_static_1",
        "--lockstep",
        "--duration",
        2,
        "--no-report",
        "--out",
        tmp_path,
    )
    assert flown.code == 1
    done = flightstack("replay", tmp_path / "flight.mcap", "--json")
    assert done.code == 2
    assert json.loads(done.out)["result"] == "unusable"
    assert "proves nothing" in done.err or "prove nothing" in done.err
