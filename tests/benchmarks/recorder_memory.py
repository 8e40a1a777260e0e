"""Ten hours of messages through feed, socket and recorder as fast as they go: memory, and cost of a write.

``python -m tests.benchmarks recorder_memory [HOURS [NTH]]``; NTH sends every n-th message only: what is kept
in memory grows with the chunks, and there are as many of them. The messages are those of a recorded flight,
with its rates and a chunk for each quarter of a second of it, so index and statistics grow as in flight.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import make_reader

from logs.reader.reader import LogFile, Message
from logs.recorder.feed import Feed
from tests.integration.runs import COMMAND, fly

HOURS = 10.0
GROWTH_MAX_MIB_H = 2.0  # the index of the chunks, compressed; it is written behind the last message
FIXED_MAX_MIB = 8.0  # on top of the first hour's: buffers of chunk, compressor and sockets, and free lists
CALL_MAX_US = 5.0  # median of a write on the control thread
SAMPLES_H = 10


def template(folder: Path) -> list[Message]:
    """One second of a flight: what clients send, without what the recorder derives from it."""
    assert fly(folder, "paper_moving_1").code == 0
    sent = [
        m for m in LogFile(folder / "flight.mcap").messages()
        if m.topic.startswith(("/cf1/sim/", "/cf1/controller/", "/uas1/", "/cf1/loop/", "/cf1/target/odom"))
    ]  # fmt: skip
    start_ns = min(m.log_time_ns for m in sent) + 5 * 10**9
    return [m for m in sent if 0 <= m.log_time_ns - start_ns < 10**9]


def resident_mib(pid: int) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def pump(feed: Feed, second: list[Message], seconds: int) -> Iterator[tuple[int, float]]:
    """Send so many seconds; yields the number of each and the wall time of its writes alone."""
    channels = {m.topic: feed.channel(m.topic, m.schema) for m in second}
    for number in range(seconds):
        spent_s = 0.0
        for part in range(0, len(second), 50):  # a few ticks between two flushes
            some, shift_ns = second[part : part + 50], number * 10**9
            begun_s = time.perf_counter()
            for m in some:
                feed.write(channels[m.topic], m.log_time_ns + shift_ns, m.publish_time_ns, m.sequence, m.data)
            spent_s += time.perf_counter() - begun_s
            feed.flush()
        yield number, spent_s


def main() -> None:
    """Run and print."""
    hours = float(sys.argv[1]) if len(sys.argv) > 1 else HOURS
    every = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        second = template(folder)[::every]
        log, socket = folder / "long.mcap", folder / "socket"
        recorder = subprocess.Popen(
            [*COMMAND, "record", "--socket", str(socket), "--out", str(log), "--until-clients", "1"],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert recorder.stdout is not None
        assert recorder.stdout.readline() == "ready\n"
        feed, begun_s = Feed.connect(str(socket), "benchmark", lossless=True), time.monotonic()
        memory: list[tuple[float, float]] = []  # hours of flight, MiB
        costs_us: list[float] = []
        seconds = round(hours * 3600)
        with log.open("rb") as stream:
            for number, spent_s in pump(feed, second, seconds):
                costs_us.append(spent_s / len(second) * 1e6)
                if number % (3600 // SAMPLES_H) == 0 or number == seconds - 1:
                    memory.append((number / 3600, resident_mib(recorder.pid)))
                    os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        feed.close()
        wall_s = time.monotonic() - begun_s
        assert recorder.wait(120.0) == 0
        _tell(log, memory, sorted(costs_us), wall_s, len(second))


def _tell(
    log: Path, memory: list[tuple[float, float]], costs_us: list[float], wall_s: float, per_s: int
) -> None:
    for hour, mib in memory[:: max(1, len(memory) // 12)]:
        print(f"{hour:5.1f} h  {mib:6.1f} MiB resident")
    hours, last_mib = memory[-1]
    first_mib = next(mib for hour, mib in memory if hour >= min(0.1, hours))
    limit_mib = FIXED_MAX_MIB + GROWTH_MAX_MIB_H * hours
    size_mib = log.stat().st_size / 2**20
    print(f"{per_s} messages a second for {hours:.1f} h in {wall_s:.0f} s: {size_mib:.0f} MiB")
    print(f"growth after the first minutes {last_mib - first_mib:.1f} MiB (limit {limit_mib:.1f} MiB)")
    print(
        f"cost of a write: median {costs_us[len(costs_us) // 2]:.2f} us (limit {CALL_MAX_US} us), "
        f"99th percentile of the seconds {costs_us[int(0.99 * len(costs_us))]:.2f} us"
    )
    with log.open("rb") as stream:
        begun_s = time.monotonic()
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    took_s = time.monotonic() - begun_s
    chunks, messages = summary.statistics.chunk_count, summary.statistics.message_count
    print(f"{messages} messages in {chunks} chunks; the index opens in {took_s:.1f} s")
