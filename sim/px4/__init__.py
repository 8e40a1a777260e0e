"""Simulator for PX4 software in the loop: it replaces the vehicle's firmware model with PX4."""
