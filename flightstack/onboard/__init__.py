"""The onboard process: links, clocks, waiting, recording, publishing."""
