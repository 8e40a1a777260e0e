"""The configuration of the onboard process as a log keeps it, and what viewers draw by it."""

from __future__ import annotations

import tomllib

from flightstack.common.strict_toml import ConfigError, from_table
from flightstack.core.parameters.flight import FlightConfig

ATTACHMENT = "onboard.toml"  # name in the log


def read_config(data: bytes) -> FlightConfig:
    """Read the attachment.

    Raises:
        ConfigError: not a configuration of this version.
    """
    try:
        return from_table(FlightConfig, tomllib.loads(data.decode()))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"not TOML: {error}") from error


def shape(config: FlightConfig) -> dict[str, str]:
    """Barrier and pad under the names that the metadata of a simulated run have, m and 1/m."""
    barrier = config.barrier.build()
    return {
        "barrier_alpha_1_m": repr(barrier.alpha_1_m),
        "barrier_beta_m": repr(barrier.beta_m),
        "pad_radius_m": repr(config.touchdown.pad_radius_m),
    }
