"""The recorder as its own process: killed, told to stop, and on a full disk."""

from __future__ import annotations

import io
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

from mcap.reader import make_reader

from logs import codec, schemas
from logs.feed import Feed
from logs.mcap_file import McapFile, SafeStream
from logs.reader import LogFile
from tests.unit.recorder_helpers import DEADLINE_S, EPOCH_NS, timing, wait_until


def start(tmp_path, *, file_limit=None, until="None"):
    """Start a recorder as its own process; returns when it listens."""
    paths = (tmp_path / "feed.sock", tmp_path / "flight.mcap")
    code = (
        "import sys; from pathlib import Path; from logs.recorder import record_main;"
        f"sys.exit(record_main(Path(sys.argv[1]), Path(sys.argv[2]), {until}))"
    )

    def limit():
        if file_limit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))

    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, paths)],
        cwd=Path(__file__).parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=limit,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    return process, *paths


def test_killed_recorder_leaves_all_but_the_last_half_second(tmp_path):
    process, path, out = start(tmp_path)
    client = Feed.connect(str(path), "onboard", lossless=True)
    channel = client.channel("/t", schemas.LOOP_TIMING)
    sent = 0

    def on_disk():
        nonlocal sent
        client.write(channel, EPOCH_NS + sent, time.monotonic_ns(), sent, timing(sent))
        client.flush()
        sent += 1
        return [m.publish_time_ns for m in LogFile(out).messages()]

    latencies = []
    for _ in range(4):
        first, begun = sent, time.monotonic()
        wait_until(lambda first=first: len(on_disk()) > first, "the record on disk")
        latencies.append(time.monotonic() - begun)
    seen = on_disk()
    process.send_signal(signal.SIGKILL)
    process.wait(DEADLINE_S)
    assert min(latencies) < 0.5  # the machine may be busy once, not always
    log = LogFile(out)
    recovered = list(log.messages())
    assert [m.sequence for m in recovered] == list(range(len(recovered)))
    assert len(recovered) >= len(seen) > 0
    assert [m.data for m in recovered] == [timing(i) for i in range(len(recovered))]
    assert not log.complete
    assert log.problem
    client.write(channel, 0, 0, 0, b"")
    client.flush()
    assert not client.alive
    client.close()


def test_told_to_stop_it_takes_what_is_in_the_sockets(tmp_path):
    process, path, out = start(tmp_path)
    client = Feed.connect(str(path), "onboard", lossless=True)
    channel = client.channel("/t", schemas.LOOP_TIMING)
    process.send_signal(signal.SIGSTOP)  # so that the records wait in the socket
    for i in range(100):
        client.write(channel, i, i, i, timing(i))
    client.flush()
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGINT)  # the second wish: at once, without waiting for the client
    process.send_signal(signal.SIGCONT)
    _, errors = process.communicate(timeout=DEADLINE_S)
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
    output, errors = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, output, errors) == (0, "", "")
    assert LogFile(out).complete


def test_full_disk_blocks_nobody_and_leaves_a_readable_file(tmp_path):
    process, path, out = start(tmp_path, file_limit=200_000, until="1")
    client = Feed.connect(str(path), "onboard", lossless=True)
    channel = client.channel("/t", schemas.MAVLINK)
    noise = os.urandom(250)
    frame = codec.pack_mavlink(1, bytes([0xFD, 250]) + bytes(8) + noise + b"ab")
    for i in range(5000):
        client.write(channel, i, i, i, frame[:-8] + os.urandom(4) + frame[-4:])
        client.flush()
    assert client.alive
    client.close()
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 1
    assert "writing failed (File too large)" in errors
    log = LogFile(out)
    sequences = [m.sequence for m in log.messages()]
    assert len(sequences) > 0
    assert sequences == list(range(len(sequences)))
    assert out.stat().st_size <= 200_000
    assert not log.complete


class SmallDisk(io.BytesIO):
    """A file on a disk with so much room."""

    room = 60_000

    def write(self, data):
        fits = min(len(data), self.room - self.tell())
        if fits <= 0:
            raise OSError(28, "No space left on device")
        return super().write(data[:fits])


class Reserve(io.BytesIO):
    def __init__(self, disk):
        super().__init__()
        self.disk = disk

    def close(self):
        self.disk.room += 400_000
        super().close()


def test_full_disk_with_reserve_still_closes_the_file(tmp_path):
    disk = SmallDisk()
    file = McapFile(tmp_path / "x.mcap", stream=SafeStream(disk, Reserve(disk)))
    disk.close = lambda: None
    channel = file.channel("/t", schemas.LOOP_TIMING)
    for i in range(5000):
        file.write(channel, i, i, i, timing(i) + os.urandom(60))
        if i % 200 == 199:
            file.flush()
    assert file.failure == "No space left on device"
    assert 0 < file.messages < 5000
    file.close()
    (tmp_path / "x.mcap").write_bytes(disk.getvalue())
    log = LogFile(tmp_path / "x.mcap")
    assert log.complete
    assert [m.sequence for m in log.messages()] == list(range(file.messages))
    with (tmp_path / "x.mcap").open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count == file.messages
