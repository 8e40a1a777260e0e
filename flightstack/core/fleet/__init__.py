"""Fleets without a leader: constraints between vehicles, and the order of landings."""
