"""Check of a vehicle's parameters before a flight."""
