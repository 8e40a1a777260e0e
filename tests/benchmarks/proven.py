"""Tests the certificate: changes each parameter over its range, and flies proven configurations.

``python -m tests.benchmarks proven [KEY ...] [--scenario NAME[+VARIANT] ...] [--filter NAME ...]``

KEY: beginning of a parameter's name, e.g. ``velocity_loop.`` or ``robust.gain_1_s``. A configuration is
rejected, not proven, or proven. A proven configuration that crashes or violates the barrier is a failure; it
causes exit status 1. The scenario's environment does not change. A variant (``deck+feedback``) adds an
optional part of the configuration, so that the parameters of this part are tested, too.
"""

import argparse
import multiprocessing
import os
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache, partial
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

from flightstack.common.strict_toml import ConfigError, from_table, to_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.verify.certificate import checks
from flightstack.verify.feedback import BANDWIDTH
from logs.verdict.types import Outcome
from sim.runners.landing import land
from sim.scenarios.scenario import Scenario, load
from sim.vehicle.declared import declared

SCENARIOS = ("lab", "field", "reversing", "deck")
FILTERS = ("robust", "paper")
DURATION_MAX_S = 60.0


@cache
def base(name: str, kind: str) -> Scenario:
    """Return a scenario with a filter; a variant adds velocity feedback or selects another touchdown rule."""
    name, _, variant = name.partition("+")
    scenario = load(name).with_filter(kind)
    if not variant:
        return scenario
    table = to_table(scenario)
    if variant == "feedback":
        # the default rates of the feedback, or lower rates if the certificate does not allow the defaults
        rate_1_s = scenario.onboard.velocity_loop.rate_xy_1_s
        rates = {"error_rate_1_s": min(5.0, rate_1_s), "tilt_rate_1_s": min(13.0, BANDWIDTH * rate_1_s)}
        rates |= {f"far_{key}": value for key, value in rates.items()} | {"far_m": 1.0, "horizontal": True}
        table["onboard"]["velocity_feedback"].update(rates)
    else:
        table["onboard"]["touchdown"]["rule"] = variant
    return from_table(Scenario, table)


class Parameter(NamedTuple):
    path: tuple[str, ...]
    low: float
    high: float
    whole: bool  # whether the parameter is an integer
    components: int  # number of components of a vector; 0: a scalar


def parameters(cls: type = FlightConfig, path: tuple[str, ...] = ()) -> Iterator[Parameter]:
    """Yield every number that has a range in its metadata, in a dataclass and its nested dataclasses."""
    hints = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        kind, below = hints[field.name], (*path, field.name)
        if type(None) in get_args(kind):  # the type is optional: use the type of the value
            kind = next(each for each in get_args(kind) if each is not type(None))
        if is_dataclass(kind):
            yield from parameters(kind, below)
            continue
        items = get_args(kind) if get_origin(kind) is tuple else ()
        kind, count = (items[0], len(items)) if items else (kind, 0)
        for span in (each for each in getattr(kind, "__metadata__", ()) if isinstance(each, msgspec.Meta)):
            yield Parameter(below, float(span.ge), float(span.le), get_args(kind)[0] is int, count)


def values(parameter: Parameter, count: int) -> list[Any]:
    """Return ``count`` values from the lower to the upper limit, in logarithmic steps."""
    low, high = parameter.low, parameter.high
    least = low or high / 100.0
    found = [least * (high / least) ** (k / (count - 1)) for k in range(count)]
    found[0], found[-1] = low, high
    return [round(each) if parameter.whole else float(f"{each:.4g}") for each in found]


Case = tuple[str, str, tuple[str, ...], Any]  # scenario, filter, path of the parameter, value


def changed(name: str, kind: str, path: tuple[str, ...], value: Any) -> Scenario:
    """Return the scenario with one parameter changed.

    Raises ConfigError: the configuration rejects this value.
    """
    table = to_table(base(name, kind))
    table["duration_max_s"] = DURATION_MAX_S
    place = table["onboard"]
    for key in path[:-1]:
        if key not in place:
            raise ConfigError(f"the scenario has no table [{key}]")
        place = place[key]
    place[path[-1]] = value
    return from_table(Scenario, table)


class Result(NamedTuple):
    """Result of ``check`` and of the flights with one changed configuration."""

    scenario: str
    filter: str
    key: str
    value: Any
    verdict: str  # "refused", "not proven" or "proven"
    because: str  # the error message, or the checks that are not proven
    outcomes: dict[str, int]
    failures: tuple[int, ...]  # seeds of crashes and violations


def fly(case: Case, first_seed: int, runs: int, stop: int = 3) -> Result:
    """Check one changed configuration; if it is proven, fly ``runs`` seeds or until ``stop`` failures."""
    name, kind, path, value = case
    key = ".".join(path)
    try:
        scenario = changed(name, kind, path, value)
        claims = [*checks(scenario.onboard), *declared(scenario)]
        missing = [each.name for each in claims if not each.proven]
    except ValueError as error:
        return Result(name, kind, key, value, "refused", str(error), {}, ())
    if missing:
        return Result(name, kind, key, value, "not proven", ", ".join(missing), {}, ())
    outcomes: Counter[str] = Counter()
    failures: list[int] = []
    for seed in range(first_seed, first_seed + runs):
        found = land(scenario, seed).verdict
        outcomes[found.outcome.name] += 1
        if found.violation or found.outcome is Outcome.CRASHED:
            failures.append(seed)
        if len(failures) == stop:
            break
    return Result(name, kind, key, value, "proven", "", dict(outcomes), tuple(failures))


def cases(keys: list[str], names: list[str], kinds: list[str], count: int) -> Iterator[Case]:
    """Yield every requested change; in a vector, first all components change, then only the last."""
    for parameter in parameters():
        if keys and not any(".".join(parameter.path).startswith(key) for key in keys):
            continue
        for name in names:
            for kind in kinds:
                for value in values(parameter, count):
                    if not parameter.components:
                        yield name, kind, parameter.path, value
                        continue
                    vector = [value] * parameter.components
                    yield name, kind, parameter.path, vector
                    place: Any = to_table(base(name, kind).onboard)
                    for key in parameter.path:
                        place = place.get(key) if place is not None else None
                    if place is not None:
                        yield name, kind, parameter.path, [*place[:-1], value]


def main() -> None:
    """Fly the requested changes; print one line per change, and the failures again at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("keys", nargs="*", help="beginnings of parameters' names; none: all")
    parser.add_argument("--scenario", nargs="*", default=SCENARIOS)
    parser.add_argument("--filter", nargs="*", default=FILTERS)
    parser.add_argument("--values", type=int, default=5)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    wanted = list(cases(asked.keys, asked.scenario, asked.filter, asked.values))
    told: Counter[str] = Counter()
    failed = []
    with multiprocessing.get_context("spawn").Pool(asked.workers) as pool:
        for each in pool.imap(
            partial(fly, first_seed=asked.first_seed, runs=asked.runs), wanted, chunksize=1
        ):
            told[each.verdict] += 1
            line = f"{each.scenario} {each.filter} {each.key} = {each.value}: {each.verdict} {each.because}"
            print(line, each.outcomes or "", f"FAILS {each.failures}" if each.failures else "", flush=True)
            if each.failures:
                failed.append(line)
    print(f"\n{len(wanted)} changes: {dict(told)}; proven and failed: {len(failed)}")
    print(*failed, sep="\n")
    sys.exit(bool(failed))
