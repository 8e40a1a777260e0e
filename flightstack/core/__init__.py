"""The controller: pure, one step per tick; imports nothing else of the project but ``common``."""
