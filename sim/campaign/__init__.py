"""Many seeded landings of one scenario: flown by ``run``, kept as ``rows``, summed up by ``summary``."""
