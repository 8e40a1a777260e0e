"""The simulator: software-in-the-loop vehicle, ground robot and the world around them."""

import os

# MuJoCo only computes physics here; with rendering, importing it would start a process to look for OpenGL.
os.environ.setdefault("MUJOCO_GL", "disable")
