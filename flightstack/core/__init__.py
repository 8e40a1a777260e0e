"""Pure flight controller with one step per tick; outside this package it imports only ``common``."""
