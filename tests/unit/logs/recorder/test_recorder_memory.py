"""What the recorder keeps in memory for the index grows by little, and the index is right all the same."""

from __future__ import annotations

import io
import tracemalloc

from mcap.reader import make_reader

from logs.recorder.mcap_writer import ChunkedWriter

CHANNELS = 18  # of a flight
BYTES_A_CHUNK = 250  # 3.6 MB an hour; a list of index records takes ten times as much


class Sink(io.RawIOBase):
    """Takes everything and keeps nothing."""

    size = 0

    def write(self, data):
        self.size += len(data)
        return len(data)

    def tell(self):
        return self.size


def write_chunks(writer, numbers):
    for chunk in numbers:
        for channel in range(1, CHANNELS + 1):
            writer.add_message(channel, chunk * 250_000_000 + channel, 0, chunk, b"payload")
        writer.flush()


def started(output):
    writer = ChunkedWriter(output, 2**20)
    writer.start("ros2", "test")
    for number in range(CHANNELS):
        writer.register_channel(f"/topic{number}", "cdr", writer.register_schema(f"T{number}", "x", b""), {})
    return writer


def test_memory_grows_by_a_bounded_amount_a_chunk():
    writer = started(Sink())
    tracemalloc.start()
    try:
        write_chunks(writer, range(1500))
        before, _ = tracemalloc.get_traced_memory()
        write_chunks(writer, range(1500, 5500))
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 0 < (after - before) / 4000 < BYTES_A_CHUNK


def test_an_index_of_many_compressed_blocks_finds_every_message():
    chunks = 3000  # 680 kB of index: more than two blocks
    output = io.BytesIO()
    writer = started(output)
    write_chunks(writer, range(chunks))
    assert writer.index_bytes > 2 * 2**18
    writer.finish()
    reader = make_reader(io.BytesIO(output.getvalue()), validate_crcs=True)
    summary = reader.get_summary()
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count == chunks
    found = [(c.topic, m.sequence) for _, c, m in reader.iter_messages(topics=["/topic7"])]
    assert found == [("/topic7", i) for i in range(chunks)]
    late = reader.iter_messages(starting_at=2990 * 250_000_000)
    assert {m.sequence for _, _, m in late} == set(range(2990, chunks))
