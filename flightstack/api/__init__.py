"""The library behind ``import flightstack as fs``."""
