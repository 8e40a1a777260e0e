"""Real time at 100 Hz: relative standard deviation of the period, and overruns, over one flight.

The limit in the same run is a loop that only sleeps: what the machine itself allows.
"""

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from flightstack.common.pacing import RealTimePacer, ask_for_priority
from logs.reader.reader import LogFile
from logs.schema.rows import LoopTimingRow


def bare_loop(ticks: int = 1500) -> tuple[float, int]:
    """Relative standard deviation and overruns of a loop without any work."""
    ask_for_priority()
    pacer = RealTimePacer(100)
    periods = [pacer.wait().period_s for _ in range(ticks)][1:]
    return statistics.pstdev(periods) / statistics.fmean(periods), pacer.overruns


def main() -> None:
    """Run and print."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "flightstack.cli.main", "sitl", "--scenario", "paper_moving_1", "--json",
             "--no-report", "--out", folder],
            capture_output=True, timeout=300, check=False,
        )  # fmt: skip
        log = LogFile(Path(folder) / "flight.mcap")
        rows = [LoopTimingRow.unpack(m.data) for m in log.messages(["/cf1/loop/timing"])]
    periods = [row.period_s for row in rows[1:]]
    mean = statistics.fmean(periods)
    spread = statistics.pstdev(periods) / mean
    exec_us = sorted(row.exec_s * 1e6 for row in rows)
    print(f"{len(rows)} ticks: mean period {mean * 1e3:.3f} ms, overruns {rows[-1].overruns} (limit 0)")
    print(f"relative standard deviation of the period {spread:.2%} (limit 5 %)")
    bare, bare_overruns = bare_loop()
    print(f"a loop that only sleeps, in the same minute: {bare:.2%}, overruns {bare_overruns}")
    p50, p99 = (exec_us[int(len(exec_us) * share)] for share in (0.5, 0.99))
    print(f"decode, step and send: p50 {p50:.0f} us, p99 {p99:.0f} us")


if __name__ == "__main__":
    main()
