"""Injected faults and who carries them out."""
