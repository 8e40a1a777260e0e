"""A flight stack that lands a quadrotor on a moving target: ``import flightstack as fs``.

The names below are the public interface (docs/reference/python.md). Each one is imported at its first use.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flightstack.api.campaign import Campaign, Sweep, campaign, sweep
    from flightstack.api.env import LandingEnv, make_env
    from flightstack.api.frames import frame
    from flightstack.api.landing import Landing, land, read_log, scenario
    from flightstack.core.strategies.packaged.robust import RobustFilter
    from flightstack.core.strategies.strategy import Filter
    from flightstack.core.strategies.user_filter import At

__all__ = [
    "At", "Campaign", "Filter", "Landing", "LandingEnv", "RobustFilter", "Sweep", "campaign", "frame",
    "land", "make_env", "read_log", "scenario", "sweep",
]  # fmt: skip
_NAMES = {
    "flightstack.api.campaign": ("Campaign", "Sweep", "campaign", "sweep"),
    "flightstack.api.env": ("LandingEnv", "make_env"),
    "flightstack.api.frames": ("frame",),
    "flightstack.api.landing": ("Landing", "land", "read_log", "scenario"),
    "flightstack.core.strategies.packaged.robust": ("RobustFilter",),
    "flightstack.core.strategies.strategy": ("Filter",),
    "flightstack.core.strategies.user_filter": ("At",),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'flightstack' has no attribute {name!r}; it has {', '.join(__all__)}")
    from flightstack.common.text import needed_by

    with needed_by(f"flightstack.{name}"):
        found = getattr(import_module(_HOME[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


# If Gymnasium was imported before, register the environment's name now; else ``api.env`` registers the name.
if "gymnasium" in sys.modules:
    sys.modules["gymnasium"].register("flightstack/Landing-v0", "flightstack.api.env:LandingEnv")
