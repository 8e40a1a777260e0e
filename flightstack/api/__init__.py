"""Public Python interface, which ``import flightstack as fs`` provides."""
