"""The certificate: proves what the filter guarantees for a configuration, and that it is feasible."""
