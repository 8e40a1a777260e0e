"""All benchmarks, one after the other: ``make bench``. Numbers go to standard output."""

from tests.benchmarks import control_step, lockstep, loop_period, qp_agreement

if __name__ == "__main__":
    for benchmark in (control_step, qp_agreement, lockstep, loop_period):
        print(
            f"\n== {benchmark.__name__.rpartition('.')[2]}: {benchmark.__doc__.splitlines()[0]}", flush=True
        )
        benchmark.main()
