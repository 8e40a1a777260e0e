"""Tests feed and recorder with sockets and files: buffers are bounded, and losses are reported."""

from __future__ import annotations

import socket
import threading

import msgspec
import pytest
from mcap.reader import make_reader

from logs.reader.reader import LogFile
from logs.recorder import feed
from logs.recorder.feed import (
    CONTROL,
    HEADER,
    Attachment,
    Declare,
    Feed,
    FeedError,
    Goodbye,
    Losses,
    control,
    encode,
    split,
)
from logs.recorder.recorder import RecorderError, RecorderProcess, problems
from logs.recorder.recording import McapFile, Recorder
from logs.schema import schemas
from logs.schema.events import Severity
from logs.schema.rows import LogRow
from tests.processes.bounded import PATIENCE_S
from tests.unit.logs.helpers import EPOCH_NS, timing


class InThread:
    """Runs a recorder in a thread, until the end of the ``with`` block."""

    def __init__(self, tmp_path, until=None):
        self.socket = tmp_path / "feed.sock"
        self.out = tmp_path / "flight.mcap"
        self.process = RecorderProcess(self.socket, self.out)
        self.until = until
        self.statistics = None
        self.thread = threading.Thread(target=self._run)

    def _run(self):
        self.statistics = self.process.run(self.until)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        if self.until is None or error[0]:
            self.process.stop()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()

    def feed(self, name, lossless=True):
        return Feed.connect(str(self.socket), name, lossless=lossless)


def test_two_clients_one_channel_every_byte(tmp_path):
    with InThread(tmp_path, until=2) as recorder:
        one, two = recorder.feed("one"), recorder.feed("two")
        one.metadata("run", {"scenario": "paper_moving_1", "seed": "7"})
        one.attachment("scenario.toml", "application/toml", b"a = 1\n\x00\xff")
        for client, first in ((one, 0), (two, 1000)):
            channel = client.channel("/cf1/loop/timing", schemas.LOOP_TIMING)
            assert client.channel("/cf1/loop/timing", schemas.LOOP_TIMING) == channel
            for tick in range(first, first + 500):
                client.write(channel, EPOCH_NS + tick, EPOCH_NS + tick - 5, tick, timing(tick))
                client.flush()
        one.close()
        two.close()
    log = LogFile(recorder.out)
    assert log.complete
    messages = sorted(log.messages(), key=lambda m: m.sequence)
    assert [m.sequence for m in messages] == [*range(500), *range(1000, 1500)]
    for m in messages:
        assert (m.topic, m.schema) == ("/cf1/loop/timing", schemas.LOOP_TIMING)
        assert (m.log_time_ns, m.publish_time_ns) == (EPOCH_NS + m.sequence, EPOCH_NS + m.sequence - 5)
        assert m.data == timing(m.sequence)
    assert log.metadata()["run"] == {"scenario": "paper_moving_1", "seed": "7"}
    assert log.metadata()["losses"] == {"one": "0", "two": "0"}
    (attachment,) = log.attachments()
    assert (attachment.name, attachment.media_type) == ("scenario.toml", "application/toml")
    assert attachment.data == b"a = 1\n\x00\xff"
    counts = recorder.statistics
    assert (counts.clients, counts.invalid, counts.crashed) == (2, 0, 0)
    assert problems(counts) == []
    with recorder.out.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        assert "crazyflie-flightstack" in reader.get_header().library
        summary = reader.get_summary()
    assert summary.statistics.message_count == 1000
    (channel,) = summary.channels.values()
    assert channel.message_encoding == "cdr"
    told = {"offered_qos_profiles": "[]", "topic_type_hash": schemas.type_hash(schemas.LOOP_TIMING)}
    assert channel.metadata == told
    assert {c.compression for c in summary.chunk_indexes} == {"lz4"}


def test_crash_in_the_middle_of_a_record(tmp_path):
    with InThread(tmp_path, until=1) as recorder, socket.socket(socket.AF_UNIX) as raw:
        raw.connect(str(recorder.socket))
        whole = control(Losses("onboard", 0)) + control(Declare(1, "/t", schemas.LOOP_TIMING))
        raw.sendall(whole + encode(1, 9, 9, 0, timing(0)) + encode(1, 10, 10, 1, timing(1))[:40])
    log = LogFile(recorder.out)
    assert log.complete
    message, event = log.messages()
    assert message.data == timing(0)
    row = LogRow.unpack(event.data)
    assert (event.topic, row.level) == ("/rosout", Severity.ERROR)
    assert row.msg == "onboard ended without a goodbye; 40 bytes of an unfinished record lost"
    assert recorder.statistics.unfinished_bytes == 40
    assert log.metadata()["recorder"]["unfinished_bytes"] == "40"
    assert "1 clients ended without a goodbye" in problems(recorder.statistics)[0]


def test_nonsense_is_counted_and_harms_nobody_else(tmp_path):
    with InThread(tmp_path, until=3) as recorder:
        good = recorder.feed("good")
        channel = good.channel("/t", schemas.LOOP_TIMING)
        with socket.socket(socket.AF_UNIX) as raw:
            raw.connect(str(recorder.socket))
            raw.sendall(HEADER.pack(2**32 - 1, 1, 0, 0, 0) + b"x" * 100)  # an impossible length
        with socket.socket(socket.AF_UNIX) as raw:
            raw.connect(str(recorder.socket))
            bad_topic = control(Declare(3, "/~~~", schemas.LOG)).replace(b"~~~", b"\xed\xa0\x80")
            bad_values = msgspec.msgpack.encode({"type": "Metadata", "name": "run", "values": 3})
            raw.sendall(
                encode(5, 0, 0, 0, b"never declared")
                + encode(CONTROL, 0, 0, 0, b"no MessagePack")
                + control(Declare(1, "/x", "no_msgs/msg/Nothing"))
                + encode(CONTROL, 0, 0, 0, bad_values)
                + encode(CONTROL, 0, 0, 0, msgspec.msgpack.encode({"type": "Unknown"}))
                + control(Declare(2, "/step", schemas.CONTROLLER_STEP))
                + encode(2, 0, 0, 0, b"no controller step")
                + encode(2, -1, 0, 0, b"before 1970")
                + bad_topic
                + control(Attachment("a", "b", b""), -1)
            )  # fmt: skip
        good.write(channel, 1, 1, 1, timing(1))
        good.close()
    log = LogFile(recorder.out)
    assert log.complete
    assert recorder.statistics.invalid == 10
    assert [m.data for m in log.messages({"/t"})] == [timing(1)]
    texts = "\n".join(LogRow.unpack(m.data).msg for m in log.messages({"/rosout"}))
    assert "record of channel 5: it was never declared" in texts
    assert "unknown message type 'no_msgs/msg/Nothing'" in texts


def deaf_server(tmp_path):
    """Return a listening socket that reads nothing, and its path."""
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(tmp_path / "deaf.sock"))
    server.listen(1)
    return server, str(tmp_path / "deaf.sock")


@pytest.mark.parametrize("vehicles", [1, 2])
def test_slow_recorder_never_blocks_real_time_and_drops_are_counted(tmp_path, vehicles):
    server, path = deaf_server(tmp_path)
    client = Feed.connect(path, "onboard", lossless=False, vehicles=vehicles)
    peer, _ = server.accept()
    channel = client.channel("/t", schemas.LOOP_TIMING)
    payload, total = bytes(10_000), 1500
    for i in range(total):  # 15 MB into a socket without a reader: a blocking send would never return
        client.write(channel, i, i, i, payload)
        client.flush()
        assert len(client._buffer) <= vehicles * feed.BUFFER_LIMIT
    assert client.alive
    assert 0 < client.dropped <= total - vehicles * feed.BUFFER_LIMIT // 10_100
    received, records = bytearray(), []
    peer.setblocking(False)
    while not records or records[-1].channel != CONTROL or client._buffer:
        client.flush()
        try:
            received += peer.recv(2**20)
        except BlockingIOError:
            continue
        records += split(received)
    messages = [r for r in records if r.channel != CONTROL]
    assert [m.sequence for m in messages] == list(range(len(messages)))  # the newest records were dropped
    assert len(messages) + client.dropped == total
    assert msgspec.msgpack.decode(records[-1].payload, type=Losses).dropped == client.dropped
    client.close()
    peer.close()
    server.close()


def test_lossless_waits_for_a_slow_recorder(tmp_path):
    server, path = deaf_server(tmp_path)
    client = Feed.connect(path, "onboard", lossless=True)
    peer, _ = server.accept()
    sequences = []

    def read_slowly():
        received = bytearray()
        while data := peer.recv(4096):
            received.extend(data)
            sequences.extend(r.sequence for r in split(received) if r.channel != CONTROL)

    reader = threading.Thread(target=read_slowly)
    reader.start()
    channel = client.channel("/t", schemas.LOOP_TIMING)
    for i in range(800):
        client.write(channel, i, i, i, bytes(10_000))
        if i % 7 == 0:
            client.flush()
    client.close()
    reader.join(PATIENCE_S)
    assert sequences == list(range(800))
    assert client.dropped == 0
    peer.close()
    server.close()


@pytest.mark.parametrize("lossless", [True, False])
def test_dead_recorder_is_noticed_and_never_raises(tmp_path, lossless):
    server, path = deaf_server(tmp_path)
    client = Feed.connect(path, "onboard", lossless=lossless)
    server.accept()[0].close()
    channel = client.channel("/t", schemas.LOOP_TIMING)
    client.write(channel, 0, 0, 0, b"x")
    client.flush()
    assert not client.alive
    client.write(channel, 1, 1, 1, b"x")
    client.flush()
    assert client.dropped == 1
    client.close()
    client.write(channel, 2, 2, 2, b"x")
    client.flush()
    client.close()
    server.close()


def test_lossless_wait_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(feed, "PATIENCE_S", 0.05)
    server, path = deaf_server(tmp_path)
    client = Feed.connect(path, "onboard", lossless=True)
    channel = client.channel("/t", schemas.LOOP_TIMING)
    for i in range(400):
        client.write(channel, i, i, i, bytes(10_000))
        client.flush()
    assert not client.alive
    assert client.dropped > 0
    server.close()


def test_paths_that_are_taken(tmp_path):
    (tmp_path / "flight.mcap").write_bytes(b"someone's flight")
    with pytest.raises(RecorderError, match="exists already"):
        RecorderProcess(tmp_path / "a.sock", tmp_path / "flight.mcap")
    assert not (tmp_path / "a.sock").exists()
    assert (tmp_path / "flight.mcap").read_bytes() == b"someone's flight"
    with pytest.raises(RecorderError, match="at most 107 bytes"):
        RecorderProcess(tmp_path / ("x" * 120), tmp_path / "b.mcap")
    with pytest.raises(RecorderError, match="cannot write the log"):
        RecorderProcess(tmp_path / "a.sock", tmp_path / "no such directory" / "b.mcap")
    with socket.socket(socket.AF_UNIX) as stale:
        stale.bind(str(tmp_path / "stale.sock"))
    process = RecorderProcess(tmp_path / "stale.sock", tmp_path / "c.mcap")  # a socket without a listener
    with pytest.raises(RecorderError, match="in use"):
        RecorderProcess(tmp_path / "stale.sock", tmp_path / "d.mcap")  # a recorder listens at this socket
    process.stop()
    process.run()


def test_drops_reported_by_a_client_are_in_the_log(tmp_path):
    recorder = Recorder(McapFile(tmp_path / "x.mcap"))
    client = recorder.client()
    for dropped in (0, 3, 3, 8):
        data = control(Losses("onboard", dropped))
        for i in range(0, len(data), 5):  # the data may be split at any byte
            recorder.take(client, data[i : i + 5])
    recorder.take(client, control(Goodbye()))
    recorder.gone(client)
    recorder.finish()
    log = LogFile(tmp_path / "x.mcap")
    texts = [LogRow.unpack(m.data).msg for m in log.messages({"/rosout"})]
    assert texts == [f"onboard dropped {n} records so far: the recorder did not keep up" for n in (3, 8)]
    assert log.metadata()["losses"] == {"onboard": "8"}
    assert problems(recorder.statistics) == ["onboard dropped 8 records, the recorder did not keep up"]


def test_no_recorder_is_a_clear_error(tmp_path):
    with pytest.raises(FeedError, match="flightstack record"):
        Feed.connect(str(tmp_path / "nobody.sock"), "onboard", lossless=False)
