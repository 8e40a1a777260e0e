"""Batches of ticks ("stretches") of a landing that run in one compiled call, while nothing rare happens."""
