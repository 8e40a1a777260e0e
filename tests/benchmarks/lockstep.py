"""Lockstep with recording, as a multiple of real time: whole runs over MAVLink and Zenoh, three seeds."""

import json
import statistics
import subprocess
import sys
import tempfile


def fly(*arguments: str) -> dict:
    """One run of ``flightstack sitl``; its result."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "flightstack.cli.main",
                "sitl",
                "--json",
                "--no-report",
                "--out",
                folder,
                *arguments,
            ],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    return json.loads(done.stdout.strip().splitlines()[-1])


def main() -> None:
    """Run and print."""
    factors = [
        fly("--scenario", "paper_moving_1", "--lockstep", "--seed", str(seed))["realtime_factor"]
        for seed in range(3)
    ]
    runs = ", ".join(f"{f:.1f}" for f in factors)
    print(f"{statistics.median(factors):.1f} x real time (asked 20); runs {runs}")


if __name__ == "__main__":
    main()
