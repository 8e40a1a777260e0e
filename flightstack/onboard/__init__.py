"""The onboard process: its links, clocks, recording and publishing."""
