"""Golden logs: ``python -m tests.golden`` checks them, ``... update [NAME...]`` flies them again.

Update the logs after a change of the controller that is meant to change decisions. The update prints the
decisions that differ on the old inputs, then flies again.
"""

import sys
import tempfile
from pathlib import Path

from logs.replay.replay import ReplayError, Result, replay
from tests.golden.flights import BYTES_MAX, FLIGHTS, fly, path_of


def phases(result: Result) -> set[str]:
    return {change.phase for change in result.phases_recorded}


def report(name: str) -> bool:
    """Print how a golden log differs from the current code's decisions; return whether both are equal."""
    path = path_of(name)
    if not path.exists():
        print(f"{name}: not there yet")
        return False
    try:
        result = replay(path)
    except ReplayError as error:
        print(f"{name}: cannot be replayed: {error}")
        return False
    wire = result.wire.count if result.wire is not None else 0
    print(
        f"{name}: {result.compared} ticks, {result.outputs.count} differences of decisions and events, "
        f"{result.states.count} of the state, {wire} of the wire; set-point differs in "
        f"{result.command_ticks} ticks, at most by {result.command_most_m_s:.3g} m/s"
    )
    for each in (
        *result.outputs.first[:3],
        *result.states.first[:2],
        *(result.wire or result.states).first[:2],
    ):
        print(f"  {each}")
    return result.equal


def update(name: str) -> None:
    """Fly a golden log again; a new log that replays equally, is complete and small replaces the old one."""
    flight = FLIGHTS[name]
    with tempfile.TemporaryDirectory(dir=path_of(name).parent) as folder:
        fresh = Path(folder) / "fresh.mcap"
        fly(flight, fresh)
        result, size = replay(fresh), fresh.stat().st_size
        missing = set(flight.phases) - phases(result)
        if not result.equal or missing or size > BYTES_MAX:
            sys.exit(
                f"{name}: not replaced: equal {result.equal}, phases missing {sorted(missing)}, {size} bytes "
                f"of at most {BYTES_MAX}"
            )
        fresh.replace(path_of(name))
    order = ", ".join(change.phase for change in result.phases_recorded)
    print(f"{name}: new log, {result.compared} ticks, {size} bytes: {order}")


def main(arguments: list[str]) -> int:
    verb, names = (arguments[0] if arguments else "check"), arguments[1:] or list(FLIGHTS)
    unknown = set(names) - set(FLIGHTS)
    if verb not in ("check", "update") or unknown:
        print(f"usage: python -m tests.golden [check|update] [{'|'.join(FLIGHTS)}]...", file=sys.stderr)
        return 2
    equal = [report(name) for name in names]
    if verb == "update":
        for name in names:
            update(name)
        return 0
    return 0 if all(equal) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
