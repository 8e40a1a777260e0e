"""Flights of a real PX4 on the simulated plant: landings, faults, speed."""
