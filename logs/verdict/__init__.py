"""Verdicts on flights, from their logs."""
