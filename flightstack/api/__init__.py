"""Library that ``import flightstack as fs`` provides."""
