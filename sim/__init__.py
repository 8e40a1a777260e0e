"""The simulator: software-in-the-loop vehicle, ground robot and the world around them."""

import os

# MuJoCo only computes physics here: with rendering enabled its import starts a process that searches OpenGL.
os.environ.setdefault("MUJOCO_GL", "disable")
