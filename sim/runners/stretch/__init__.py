"""Stretches: ticks of a landing that run in one compiled call, because nothing rare happens in them."""
