"""All benchmarks, one after the other: ``make bench``. Numbers go to standard output.

``python -m tests.benchmarks NAME [ARGUMENTS]`` runs one alone.
"""

import importlib
import sys

from tests.benchmarks import (
    campaign_speed,
    codec,
    control_step,
    fuzz_vehicle,
    lockstep,
    loop_period,
    qp_agreement,
    vehicle_speed,
)

if __name__ == "__main__":
    if len(sys.argv) > 1:
        one = importlib.import_module(f"tests.benchmarks.{sys.argv[1]}")
        del sys.argv[1]
        one.main()
        sys.exit()
    for benchmark in (
        campaign_speed,
        codec,
        control_step,
        fuzz_vehicle,
        lockstep,
        loop_period,
        qp_agreement,
        vehicle_speed,
    ):
        print(
            f"\n== {benchmark.__name__.rpartition('.')[2]}: {benchmark.__doc__.splitlines()[0]}", flush=True
        )
        benchmark.main()
