"""``--set KEY=VALUE``: a recorded configuration with some values changed, checked like any other."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Sequence
from typing import Any

from flightstack.common.strict_toml import ConfigError, from_table
from flightstack.core.parameters.flight import FlightConfig


def changed(table: dict[str, Any], settings: Sequence[str]) -> FlightConfig:
    """Return the configuration of ``table`` with each ``section.key=value`` set.

    Args:
        table: plain TOML data; left as it is.
        settings: values in TOML; a word that is none is taken as text, so that ``filter=paper`` does.

    Raises:
        ConfigError: not of this form, an unknown key, or a value that is not allowed.
    """
    table = copy.deepcopy(table)
    for setting in settings:
        key, equals, text = setting.partition("=")
        *sections, name = key.strip().split(".")
        if not equals or not name or not all(sections):
            raise ConfigError(
                f"--set {setting}: KEY=VALUE is needed, for example barrier.alpha_1_m=1.2 or filter=paper"
            )
        inner = table
        for section in sections:
            inner = inner.setdefault(section, {})
            if not isinstance(inner, dict):
                raise ConfigError(f"--set {setting}: {section} is a value and has no keys of its own")
        inner[name] = _value(text.strip())
    return from_table(FlightConfig, table)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
