"""Scenarios for the library: by name, by file, or as an object, with changes of single keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from operator import index
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from flightstack.common.strict_toml import ConfigError, from_table, over, to_table
from flightstack.core.parameters.filters import give, look_here
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_class
from sim.scenarios.scenario import Scenario, load, one_pad

Changes: TypeAlias = Mapping[str, Any]
FilterLike: TypeAlias = str | type[Any] | None
_SCENARIO = frozenset(field.name for field in fields(Scenario))
_FLOWN = frozenset(field.name for field in fields(FlightConfig))
_PAD = ("onboard", "touchdown", "pad_radius_m")


def scenario(
    name: str | Path | Scenario = "lab", changes: Changes | None = None, *, filter: FilterLike = None
) -> Scenario:
    """Return a scenario with changes of some keys, made for each of its vehicles.

    Args:
        name: name of a packaged scenario, path of a file, or scenario object.
        changes: values by key, e.g. ``{"wind.mean_m_s": 1.0, "barrier.omega_1_s": 0.7}``; keys of the flown
        configuration need no ``onboard.`` unless the scenario has a table of that name.
        filter: ``"paper"``, ``"robust"``, ``MODULE:NAME`` or a class; None: that of the scenario.

    Raises:
        ConfigError: unknown scenario or key, wrong unit or type, value out of range.
    """
    made = name if isinstance(name, Scenario) else load(name)
    if filter is not None:
        changes = {**(changes or {}), "onboard.filter": filter_name(filter)}
    if not changes:
        return made
    if "others" in (_path(key)[0] for key in changes):
        raise ConfigError("others: unknown key; each change is made for all vehicles of the scenario")
    return Scenario.of(_changed(each, changes) for each in made.members)


def single(name: str | Path | Scenario, changes: Changes | None, filter: FilterLike) -> Scenario:
    """Return a scenario of one vehicle as ``scenario`` does. Raises ConfigError: it has several vehicles."""
    made = scenario(name, changes, filter=filter)
    made.one(0, None)
    return made


def _changed(member: Scenario, changes: Changes) -> Scenario:
    table = to_table(member)
    for key, value in changes.items():
        part = _plain(value)
        for step in reversed(_path(key)):
            part = {step: part}
        table = over(table, part)
    if _PAD not in map(_path, changes):  # the configuration's value follows that of the robot's pad
        del table["onboard"]["touchdown"]["pad_radius_m"]
    return from_table(Scenario, one_pad(table))


def whole(what: str, found: object, low: int = 0) -> int:
    """Return a Python or numpy integer as int. Raises ConfigError: it is no integer, or below ``low``."""
    number = None if isinstance(found, bool) or not hasattr(found, "__index__") else index(found)
    if number is None or number < low:
        raise ConfigError(f"{what}: found {found!r:.60}, a whole number from {low} on is needed")
    return number


def filter_name(filter: str | type[Any]) -> str:
    """Return the name of a filter for the configuration. Raises ConfigError: it is no filter."""
    name = filter if isinstance(filter, str) else give(filter)
    look_here(name)
    strategy_class(name)
    return name


def _path(key: str) -> tuple[str, ...]:
    """Return the table names and the key name, from the scenario's root."""
    if not isinstance(key, str):
        raise ConfigError(f"changes: found the key {key!r}, a text such as 'wind.mean_m_s' is needed")
    steps = tuple(key.split("."))
    return steps if steps[0] in _SCENARIO or steps[0] not in _FLOWN else ("onboard", *steps)


def _plain(value: Any) -> Any:
    """Return a value as TOML can store it; numpy arrays become lists."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_plain(each) for each in value] if isinstance(value, tuple | list) else value
