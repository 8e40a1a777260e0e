"""Configurations of the onboard process: TOML files of this package by name, and files of the user."""

from __future__ import annotations

from pathlib import Path

from flightstack.common.strict_toml import Files
from flightstack.core.parameters.filters import look_here
from flightstack.core.parameters.flight import FlightConfig

_PRINTS = "; `flightstack config NAME` prints one, `flightstack scenarios NAME` prints a scenario"
FILES = Files(FlightConfig, "flightstack.config", "configuration", _PRINTS)
names, path_of = FILES.names, FILES.path_of


def load(name_or_file: str | Path) -> FlightConfig:
    """Read and check a configuration by name or path.

    Raises ConfigError: the text gives file, key, value and allowed values.
    """
    config = FILES.load(name_or_file)
    look_here(config.filter)
    return config
