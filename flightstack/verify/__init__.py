"""The certificate: a proof of the filter's guarantees, and of its feasibility, for a configuration."""
