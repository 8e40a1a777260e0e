"""Presents a Crazyflie with stock firmware, reached through cflib, to MAVLink clients as a vehicle."""
