"""The certificate: what the filter promises for these numbers, and whether its program has a solution."""
