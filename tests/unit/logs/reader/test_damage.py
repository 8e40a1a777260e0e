"""Tests damaged logs and invalid files: each subcommand reads the readable part and reports the damage."""

import random
import re
import struct
import zlib

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from flightstack.cli.main import main
from logs.reader.mcap_records import MAGIC
from logs.reader.reader import LogError, LogFile
from logs.recorder.recording import McapFile
from logs.schema import schemas
from logs.schema.rows import LoopTimingRow
from tests.unit.logs.helpers import EPOCH_NS, record

KINDS = {
    "zstd": {"compression": CompressionType.ZSTD},
    "none": {"compression": CompressionType.NONE},
    "no_crc": {"compression": CompressionType.NONE, "enable_crcs": False},
    "no_index": {"compression": CompressionType.LZ4, "index_types": IndexType.NONE},
    "no_chunks": {"use_chunking": False, "enable_crcs": False},
}
VERBS = (
    ("log", "info"),
    ("log", "verdict"),
    ("log", "recover", "--force", "--out", "o.mcap"),
    ("log", "export", "--force", "--topic", "/cf1/controller/step", "--format", "csv", "--out", "o.csv"),
    ("replay",),
    ("identify",),
)


def rows(path):
    return rows_of(LogFile(path))


def rows_of(log):
    return [(m.topic, m.log_time_ns, m.sequence, m.data) for m in log.messages()]


def rewritten(source, path, **how):
    """Copy a log as another MCAP writer would write it, in chunks of 4 kB; return the path of the copy."""
    with source.open("rb") as stream, path.open("wb") as out:
        reader, writer, channels = make_reader(stream), Writer(out, chunk_size=4096, **how), {}
        writer.start("ros2", "test")
        for schema, channel, m in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(channels[channel.id], m.log_time, m.data, m.publish_time, m.sequence)
        for each in reader.iter_metadata():
            writer.add_metadata(each.name, each.metadata)
        for each in reader.iter_attachments():
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
        writer.finish()
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    ours = record(folder / "ours.mcap", 60)
    made = {name: rewritten(ours, folder / f"{name}.mcap", **how) for name, how in KINDS.items()}
    return {"ours": ours, **made}


def chunks(path):
    """Return (start, end) of each chunk in the file, bytes."""
    with path.open("rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    return [(c.chunk_start_offset, c.chunk_start_offset + c.chunk_length) for c in indexes]


def damaged(data, rng):
    at, size, how = rng.randrange(8, len(data)), rng.choice((1, 4, 60, 2000)), rng.randrange(6)
    if how < 3:
        data[at] ^= 1 << rng.randrange(8)
    elif how == 3:
        data[at : at + size] = bytes([rng.choice((0, 255))]) * len(data[at : at + size])
    elif how == 4:
        del data[at : at + size]
    else:
        data[at:at] = rng.randbytes(size)
    return data


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ours", *KINDS])
def test_every_verb_ends_with_a_sentence_whatever_is_damaged(logs, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bad, rng, whole, broken = tmp_path / "bad.mcap", random.Random(kind), set(rows(logs[kind])), 0
    assert len(whole) > 200
    checked = kind in ("ours", "zstd", "none")  # whether a checksum covers every byte
    assert LogFile(logs[kind]).complete
    for number in range(12):
        bad.write_bytes(damaged(bytearray(logs[kind].read_bytes()), rng))
        log = LogFile(bad)
        broken += not log.complete
        if checked:
            assert not log.complete or set(rows(bad)) == whole
            assert set(rows(bad)) <= whole
        for verb in rng.sample(VERBS, 3 if number else len(VERBS)):
            result = CliRunner().invoke(main, [*verb, str(bad)])
            assert result.exception is None or isinstance(result.exception, SystemExit), (
                verb,
                result.exc_info,
            )
            assert result.exit_code in (0, 1, 2), verb
            assert result.output.strip(), verb
    assert broken >= (6 if checked else 2)


@pytest.mark.parametrize("kind", ["ours", "zstd", "none"])
@pytest.mark.parametrize("place", ["data", "kind"])
@pytest.mark.parametrize("number", [0, -2])
def test_what_is_before_and_behind_a_damaged_chunk_is_read(logs, kind, place, number, tmp_path):
    """Messages before and after a damaged chunk are read, because the summary repeats all schemas."""
    data, spans = bytearray(logs[kind].read_bytes()), chunks(logs[kind])
    begin, end = spans[number]
    data[{"data": (begin + end) // 2, "kind": begin}[place]] ^= 0x40
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    log, found, whole = LogFile(bad), rows(bad), rows(logs[kind])
    assert 0 < len(whole) - len(found) <= 3 * len(whole) // len(spans)
    assert (found[0] == whole[0], found[-1] == whole[-1]) == (number != 0, True)
    assert not log.complete
    assert f"bytes {begin} to " in log.problem


def test_behind_a_wrong_length_nothing_is_read(logs, tmp_path):
    data, (begin, _) = bytearray(logs["ours"].read_bytes()), chunks(logs["ours"])[-2]
    data[begin + 4] ^= 0x40
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    found = rows(bad)
    assert found == rows(logs["ours"])[: len(found)] != []
    assert f"nothing after byte {begin} of " in LogFile(bad).problem


def message(channel, number):
    return frame(
        5, struct.pack("<HIQQ", channel, number, number, number) + b"\0\1\0\0" + struct.pack("<d", number)
    )


def frame(kind, body):
    return struct.pack("<BQ", kind, len(body)) + body


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def channel(number, schema, topic):
    return frame(4, struct.pack("<HH", number, schema) + text(topic) + text("cdr") + struct.pack("<I", 0))


def chunk(records, compression="", size=None, crc=0):
    size = len(records) if size is None else size
    head = struct.pack("<QQQI", 0, 0, size, crc)
    return frame(6, head + text(compression) + struct.pack("<Q", len(records)) + records)


SCHEMA = struct.pack("<H", 1) + text("std_msgs/msg/Float64") + text("ros2msg") + text("float64 data\n")
HEAD = MAGIC + frame(1, text("ros2") + text("t")) + frame(3, SCHEMA) + channel(1, 1, "/x")
END = frame(15, bytes(4)) + frame(2, bytes(20)) + MAGIC
TEN, MORE = b"".join(message(1, n) for n in range(10)), b"".join(message(1, n) for n in range(10, 20))


@pytest.mark.parametrize(
    ("between", "messages", "problem"),
    [
        (b"", 20, ""),
        (message(7, 3), 20, "a record at byte .*channel 7 was never declared"),
        (chunk(message(7, 3) + message(7, 4) + message(1, 5)), 21, "channel 7 .*in 1 more place"),
        (channel(2, 9, "/y") + message(2, 3), 20, "schema 9 of /y was never declared.*in 1 more place"),
        (channel(1, 1, "/z"), 20, "Channel 1 is declared a second time"),
        (frame(0x21, b"abc"), 20, "33 is not a valid Opcode"),
        (chunk(chunk(message(1, 3))), 20, "kind 0x06 is not known"),
        (frame(5, struct.pack("<HIQQ", 1, 3, 2**63, 3) + bytes(12)), 20, "behind the year 2262"),
        (chunk(message(1, 3), "brotli"), 20, "compression 'brotli'"),
        (chunk(message(1, 3), size=7), 20, "a chunk of .* bytes instead of 7"),
        (chunk(message(1, 3), crc=7), 20, "crc validation failed"),
        (chunk(message(1, 3) + message(1, 4)[:-3]), 21, "a record is longer than its chunk"),
        (chunk(b"\xff" * 50, "zstd"), 20, "ZstdError"),
        (chunk(b"\xff" * 50, "lz4"), 20, "RuntimeError"),
        (frame(12, text("m") + struct.pack("<I", 99)), 20, "EndOfFile"),
        (frame(5, b"abc"), 20, "kind 0x05"),
        (bytes(500), 10, "begins with a zero byte"),
        (END + END, 10, "closing magic"),
    ],
)  # fmt: skip
def test_a_log_is_complete_only_if_every_byte_was_understood(tmp_path, between, messages, problem):
    path = tmp_path / "log.mcap"
    path.write_bytes(HEAD + TEN + between + MORE + END)
    log = LogFile(path)
    assert len(list(log.messages())) == messages
    assert log.complete == (not problem)
    assert bool(log.problem) == bool(problem)
    assert re.search(problem, log.problem)


@pytest.mark.parametrize(
    "case",  # first bytes of the file; text of the error
    [
        (b"\x28\xb5\x2f\xfd" + bytes(40), "zstd -d"),
        (b"SQLite format 3\0" + bytes(40), "rosbag2"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:12\n", "git lfs pull"),
        (b"\xa3\x95\x80\x80", "DataFlash"),
        (bytes(100), "begins with 00"),
        (b"", "is empty"),
        (None, "is no file; an MCAP file is needed$"),
    ],
)
def test_what_is_no_log_is_named(tmp_path, case):
    (begin, said), path = case, tmp_path / "flight.mcap"
    path.mkdir() if begin is None else path.write_bytes(begin)
    with pytest.raises(LogError, match=said):
        LogFile(path)


@pytest.mark.slow  # quick tests cover the main cases
def test_every_byte_offset_of_a_small_log(tmp_path):
    """Of a log that ends at any byte, the messages of all complete chunks are read, and no others."""
    small, cut = (tmp_path / name for name in ("small.mcap", "cut.mcap"))
    file, timing = McapFile(small), LoopTimingRow(EPOCH_NS, 0, 0.01, 0.0, 0.0, 0.0, 0, 0)
    channel = file.channel("/t", schemas.LOOP_TIMING)
    file.metadata("run", {"seed": "1"})
    ends = {}  # number of readable messages by size of the file
    for tick in range(6):
        file.write(channel, EPOCH_NS + tick, 5, tick, timing._replace(tick=tick).pack())
        if tick % 2:
            file.flush()
            ends[small.stat().st_size] = tick + 1
    file.attachment("s.toml", "t", 3, b"x = 1")
    file.close()
    data, all_rows = small.read_bytes(), rows(small)
    assert 1500 < len(data) < 8000
    counts, found = set(), {8: []}  # numbers of messages; messages by the number of readable bytes
    for at in range(8, len(data)):
        cut.write_bytes(data[:at])
        log = LogFile(cut)
        messages = rows_of(log)
        assert not log.complete
        readable = int(re.search(r"nothing after byte (\d+) of", log.problem)[1])
        assert readable <= at
        assert messages == all_rows[: len(messages)]
        assert len(messages) >= max((n for end, n in ends.items() if end <= at), default=0)
        if readable not in found:
            cut.write_bytes(data[:readable])
            found[readable] = rows(cut)
        assert messages == found[readable]
        counts.add(len(messages))
    assert counts == {0, 2, 4, 6}


def test_our_files_have_a_checksum_of_the_data(logs):
    data = logs["ours"].read_bytes()
    at = data.rindex(struct.pack("<BQ", 15, 4))
    assert struct.unpack("<I", data[at + 9 : at + 13]) == (zlib.crc32(data[:at]),)
