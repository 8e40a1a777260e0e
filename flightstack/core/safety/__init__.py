"""Barrier function, filter program, exact projection, position loop, and the gate that checks set-points."""
