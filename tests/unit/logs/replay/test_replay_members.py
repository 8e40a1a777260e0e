"""Tests the replay of a fleet's log: members replay separately, bit by bit; the command reports all."""

import json
import math

import pytest

from flightstack.cli.main import main
from logs.reader.reader import LogFile
from logs.recorder.recording import McapFile
from logs.replay.read import FlightInputs, ReplayError

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("fleet_log")]
MEMBERS = ("cf1", "cf2", "cf3")


def run(capsys, *arguments):
    """Return exit status, standard output and error of a command in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(each) for each in arguments])
    told = capsys.readouterr()
    return ended.value.code or 0, told.out, told.err


KEPT_S = 5.0  # duration of the copied logs, s; short, because each tick is replayed


def copied(source, target, change):
    """Copy the start of a log; ``change`` returns the new data of each message, or None to remove it."""
    log, file, end_ns = LogFile(source), McapFile(target), math.inf
    for name, values in log.metadata().items():
        file.metadata(name, values)
    for each in log.attachments():
        file.attachment(each.name, each.media_type, 0, each.data)
    for m in log.messages():
        end_ns = min(end_ns, m.log_time_ns + KEPT_S * 1e9)
        if m.log_time_ns > end_ns:
            continue
        data = change(m)
        if data is not None:
            file.write(file.channel(m.topic, m.schema), m.log_time_ns, m.publish_time_ns, m.sequence, data)
    file.close()
    return target


def test_each_member_replays_bit_by_bit_and_the_command_tells_of_all(fleet, capsys):
    code, out, _ = run(capsys, "replay", fleet.log, "--check", "--json")
    told = json.loads(out)
    assert (code, told["result"], list(told["members"])) == (0, "equal", list(MEMBERS))
    assert {each["result"] for each in told["members"].values()} == {"equal"}
    code, out, _ = run(capsys, "replay", fleet.log, "--check", "--member", "cf2", "--json")
    assert (code, json.loads(out)["compared"]) == (0, told["members"]["cf2"]["compared"])
    with pytest.raises(ReplayError, match=r"fleet of cf1, cf2, cf3; choose a member"):
        FlightInputs(fleet.log)


def test_one_member_that_differs_is_told_and_one_that_proves_nothing_makes_all_unusable(
    fleet, tmp_path, capsys
):
    def change(m):
        if (m.topic, m.sequence) == ("/cf1/controller/input", 200):
            return None
        here = (m.topic, m.sequence) == ("/cf3/controller/step", 300)
        return m.data[:-1] + bytes([m.data[-1] ^ 1]) if here else m.data

    log = copied(fleet.log, tmp_path / "changed.mcap", change)
    code, out, _ = run(capsys, "replay", log, "--check", "--json")
    told = json.loads(out)
    assert (code, told["result"]) == (2, "unusable")
    results = [told["members"][member]["result"] for member in MEMBERS]
    assert results == ["unusable", "equal", "different"]
    assert "inputs or decisions of tick 200 are missing, tick 201 follows" in told["members"]["cf1"]["reason"]
    assert told["members"]["cf3"]["outputs"]["first"][0]["index"] == 300
    code, out, err = run(capsys, "replay", log, "--check")
    assert code == 2
    assert "cf1: " in err
    assert "cf2: equal" in out
    assert out.splitlines()[-1] == "cf3: different"
