"""The flight log: recording, reading, judging, reporting."""
