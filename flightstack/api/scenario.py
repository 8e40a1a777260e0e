"""Scenarios for the library: by name, by file, or as an object, with single keys changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
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
    """Scenario of one vehicle, with some keys changed.

    Args:
        name: name of a scenario of the package, file, or scenario.
        changes: values by key, e.g. ``{"wind.mean_m_s": 1.0, "barrier.omega_1_s": 0.7}``; keys of the
            configuration that flies need no ``onboard.`` unless the scenario has a table of that name.
        filter: ``"paper"``, ``"robust"``, ``MODULE:NAME`` or a class; None: the scenario's.

    Raises:
        ConfigError: unknown scenario or key, wrong unit or type, value out of range.
    """
    made = name if isinstance(name, Scenario) else load(name)
    if filter is not None:
        changes = {**(changes or {}), "onboard.filter": filter_name(filter)}
    if not changes:
        return made
    table = to_table(made)
    for key, value in changes.items():
        part = _plain(value)
        for step in reversed(_path(key)):
            part = {step: part}
        table = over(table, part)
    if _PAD not in map(_path, changes):  # it follows from the robot's
        del table["onboard"]["touchdown"]["pad_radius_m"]
    return from_table(Scenario, one_pad(table))


def filter_name(filter: str | type[Any]) -> str:
    """Name of a filter in a configuration. Raises ConfigError: it is no filter."""
    name = filter if isinstance(filter, str) else give(filter)
    look_here(name)
    strategy_class(name)
    return name


def _path(key: str) -> tuple[str, ...]:
    """Tables and name of a key, from the scenario's root."""
    if not isinstance(key, str):
        raise ConfigError(f"changes: found the key {key!r}, a text such as 'wind.mean_m_s' is needed")
    steps = tuple(key.split("."))
    return steps if steps[0] in _SCENARIO or steps[0] not in _FLOWN else ("onboard", *steps)


def _plain(value: Any) -> Any:
    """Value as TOML has it: of numpy, too."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_plain(each) for each in value] if isinstance(value, tuple | list) else value
