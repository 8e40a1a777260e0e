"""Conversion to tables: DataFrames of pandas, or of polars if pandas is not installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from flightstack.common.text import pip_install
from flightstack.core.safety.gate import GateVerdict
from flightstack.core.types import FilterStatus, Phase, Request

# enumerations of the columns whose numbers become names, and names of the computed columns
_NAMED = {"phase": Phase, "request": Request, "filter_status": FilterStatus, "gate": GateVerdict}
_DERIVED = ("e_m", "d_m")
_AXES = {3: "xyz", 4: "xyzw"}


def frame(columns: Any) -> Any:
    """Return a table with a column per array; for an array (n, 3), one column per axis (``NAME_x``, ...).

    The table of a landing's arrays also has ``e_m``, the position relative to the landing spot, and ``d_m``,
    the length of its horizontal part, m; phase, request, filter status and gate verdict are names instead of
    numbers.

    Args:
        columns: arrays of a landing (``landing.log``, ``landing.truth``), a dict of arrays, or a list of
            dataclasses or dicts, each of which becomes a row.

    Returns:
        A DataFrame of pandas; without pandas one of polars.

    Raises:
        ModuleNotFoundError: neither pandas nor polars is installed; the text names the extra.
        TypeError: ``columns`` has another type.
    """
    if isinstance(columns, list | tuple) and all(is_dataclass(row) for row in columns) and columns:
        columns = {f.name: [getattr(row, f.name) for row in columns] for f in fields(columns[0])}
    elif isinstance(columns, list | tuple) and all(isinstance(row, Mapping) for row in columns) and columns:
        columns = {name: [row[name] for row in columns] for name in columns[0]}
    elif is_dataclass(columns) and not isinstance(columns, type):
        names = [*(f.name for f in fields(columns)), *(name for name in _DERIVED if hasattr(columns, name))]
        found = {name: getattr(columns, name) for name in names}
        named = {name: kind for name, kind in _NAMED.items() if name in found}
        columns = found | {name: [kind(v).name for v in found[name]] for name, kind in named.items()}
    if not isinstance(columns, Mapping):
        raise TypeError(f"frame: found {type(columns).__name__}; give landing.log, landing.truth or a dict")
    flat: dict[str, Any] = {}
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.ndim == 2:
            flat |= {f"{name}_{axis}": values[:, k] for k, axis in enumerate(_AXES[values.shape[1]])}
        else:
            flat[name] = values
    return _made(flat)


def _made(flat: dict[str, Any]) -> Any:
    if find_spec("pandas") is not None:
        import pandas

        return pandas.DataFrame(flat)
    if find_spec("polars") is None:
        text = f"a table needs pandas or polars, neither is installed: {pip_install('export')}"
        raise ModuleNotFoundError(text, name="pandas")
    columns = {name: _plain(values) for name, values in flat.items()}
    return import_module("polars").DataFrame(columns)  # no extra depends on polars


def _plain(values: Any) -> Any:
    """Replace enums in a list by their values, because Arrow has no enums."""
    if isinstance(values, list):
        return [each.value if isinstance(each, Enum) else each for each in values]
    return values
