"""Configurations of the onboard process: TOML files of this package, found by name, and files of the user."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flightstack.common.strict_toml import Files
from flightstack.core.parameters.filters import look_here
from flightstack.core.parameters.flight import FlightConfig

_FILES = Files(FlightConfig, "flightstack.config", "configuration", "; `flightstack config NAME` prints one")
names, path_of = _FILES.names, _FILES.path_of


def table(name_or_file: str | Path) -> dict[str, Any]:
    """Parse the file of a configuration, not checked yet. Raises ConfigError: no such file, or not TOML."""
    return _FILES.table(path_of(name_or_file))


def load(name_or_file: str | Path) -> FlightConfig:
    """Read and check a configuration by name or path.

    Raises ConfigError: with file, key, what was found and what is allowed.
    """
    config = _FILES.load(name_or_file)
    look_here(config.filter)
    return config
