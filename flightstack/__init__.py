"""A flight stack that lands a quadrotor on a moving target: ``import flightstack as fs``.

The names below are the public interface (docs/reference/python.md). Each one is imported at its first use.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flightstack.api.campaign import Campaign as Campaign
    from flightstack.api.campaign import Sweep as Sweep
    from flightstack.api.campaign import campaign as campaign
    from flightstack.api.campaign import sweep as sweep
    from flightstack.api.env import LandingEnv as LandingEnv
    from flightstack.api.env import make_env as make_env
    from flightstack.api.frames import frame as frame
    from flightstack.api.landing import Landing as Landing
    from flightstack.api.landing import land as land
    from flightstack.api.landing import read_log as read_log
    from flightstack.api.landing import scenario as scenario
    from flightstack.core.strategies.robust import RobustFilter as RobustFilter
    from flightstack.core.strategies.strategy import Filter as Filter
    from flightstack.core.strategies.user_filter import At as At

_HOME = {
    "At": "flightstack.core.strategies.user_filter",
    "Campaign": "flightstack.api.campaign",
    "Filter": "flightstack.core.strategies.strategy",
    "Landing": "flightstack.api.landing",
    "LandingEnv": "flightstack.api.env",
    "RobustFilter": "flightstack.core.strategies.robust",
    "Sweep": "flightstack.api.campaign",
    "campaign": "flightstack.api.campaign",
    "frame": "flightstack.api.frames",
    "land": "flightstack.api.landing",
    "make_env": "flightstack.api.env",
    "read_log": "flightstack.api.landing",
    "scenario": "flightstack.api.landing",
    "sweep": "flightstack.api.campaign",
}
__all__ = sorted(_HOME)


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


# If Gymnasium was imported before, its short name is registered now; else ``flightstack.api.env`` does it.
if "gymnasium" in sys.modules:
    sys.modules["gymnasium"].register("flightstack/Landing-v0", "flightstack.api.env:LandingEnv")
