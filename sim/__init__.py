"""The software-in-the-loop vehicle, its ground robot and their world."""

import os

# Nothing is drawn by MuJoCo: its import would start a process that looks for a library of windows.
os.environ.setdefault("MUJOCO_GL", "disable")
