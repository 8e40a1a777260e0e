"""Tests the recorder as a process: it is killed or stopped, or its disk is full."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from logs.reader.reader import LogFile
from logs.recorder.feed import Feed
from logs.recorder.recorder import RecorderProcess, problems
from logs.recorder.recording import DiskError, McapFile, SafeStream
from logs.schema import schemas
from tests.processes.bounded import PATIENCE_S, line_of
from tests.unit.logs.helpers import timing

pytestmark = pytest.mark.slow

LIMITS = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}));"  # maximum file size, bytes
RECORD = (
    "import sys; from pathlib import Path; from logs.recorder import recorder;"
    "recorder.GRACE_S = 600.0;"  # longer than the test: only a second signal ends the recorder at once
    "sys.exit(recorder.record_main(Path(sys.argv[1]), Path(sys.argv[2]), None))"
)


def start(tmp_path, *, file_limit=None, until="None"):
    """Start a recorder as a process; return the process and its paths when the recorder listens."""
    paths = (tmp_path / "feed.sock", tmp_path / "flight.mcap")
    code = RECORD.replace("None", until)
    if file_limit:
        code = LIMITS.format(file_limit) + code
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, paths)],
        cwd=Path(__file__).parents[4],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert line_of(process.stdout) == "ready\n"
    return process, *paths


def test_told_to_stop_it_takes_what_is_in_the_sockets(tmp_path):
    process, path, out = start(tmp_path)
    client = Feed.connect(str(path), "onboard", lossless=True)
    channel = client.channel("/t", schemas.LOOP_TIMING)
    process.send_signal(signal.SIGSTOP)  # the records must wait in the socket
    for i in range(100):
        client.write(channel, i, i, i, timing(i))
    client.flush()
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGINT)  # the second signal: end immediately, without waiting for the client
    process.send_signal(signal.SIGCONT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "ended without a goodbye" in errors
    log = LogFile(out)
    assert [m.sequence for m in log.messages({"/t"})] == list(range(100))
    assert log.complete
    assert not path.exists()
    client.close()


def test_ends_by_itself_after_the_last_client(tmp_path):
    process, path, out = start(tmp_path, until="1")
    client = Feed.connect(str(path), "onboard", lossless=True)
    client.write(client.channel("/t", schemas.LOOP_TIMING), 0, 0, 0, timing(0))
    client.close()
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, output, errors) == (0, "", "")
    assert LogFile(out).complete


def test_a_disk_that_is_full_from_the_start_is_refused(tmp_path):
    process = subprocess.run(
        [sys.executable, "-c", LIMITS.format(0) + RECORD, tmp_path / "feed.sock", tmp_path / "flight.mcap"],
        cwd=Path(__file__).parents[4], capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert process.returncode == 2
    assert "cannot write the log" in process.stderr
    assert "File too large" in process.stderr
    assert "Traceback" not in process.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_cannot_keep_what_it_took_is_a_failure(tmp_path, monkeypatch):
    def broken(descriptor):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", broken)
    process = RecorderProcess(tmp_path / "feed.sock", tmp_path / "flight.mcap")
    counts = process.run()  # the recorder ends without a signal
    assert counts.failure == "Input/output error"
    assert "writing failed (Input/output error)" in problems(counts)[0]


class SmallDisk(io.BytesIO):
    """A file on a disk with ``room`` bytes."""

    room = 60_000

    def write(self, data):
        fits = min(len(data), self.room - self.tell())
        if fits <= 0:
            raise OSError(28, "No space left on device")
        return super().write(data[:fits])


def test_a_full_disk_leaves_whole_records(tmp_path):
    disk = SmallDisk()
    file = McapFile(tmp_path / "x.mcap", stream=SafeStream(disk))
    channel = file.channel("/t", schemas.LOOP_TIMING)
    with pytest.raises(DiskError, match="No space left on device"):  # noqa: PT012
        for written in range(5000):
            file.write(channel, written, written, written, timing(written) + os.urandom(60))
            if written % 200 == 199:
                file.flush()
    (tmp_path / "x.mcap").write_bytes(disk.getvalue())
    log = LogFile(tmp_path / "x.mcap")
    found = [m.sequence for m in log.messages()]
    assert found == list(range(len(found)))
    assert 0 <= written - len(found) <= 200  # the messages of the open chunk did not fit
    assert "the recorder did not close it" in log.problem
    assert f"nothing after byte {len(disk.getvalue())} of" in log.problem
