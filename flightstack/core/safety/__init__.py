"""Barrier, filter program, exact projection, position loop, and the gate that every set-point passes."""
