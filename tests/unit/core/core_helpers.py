"""Configurations for the tests of the core."""

from flightstack.common.strict_toml import from_table
from flightstack.core.parameters.flight import FlightConfig

SLOW = {"velocity_max_m_s": [0.4, 0.4, 0.5]}  # section ``limits`` of a slow vehicle, m/s


def config(filter="robust", **sections):
    """Return a configuration with the paper's barrier; ``sections`` replace sections of the defaults."""
    return from_table(
        FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}, "filter": filter, **sections}
    )
