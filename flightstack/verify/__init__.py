"""The certificate: proves the guarantees of the filter for a configuration, and its feasibility."""
