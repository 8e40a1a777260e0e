"""Publish the odometry of a simulated robot that drives a circle, over Zenoh, 50 times a second.

python examples/publish_target.py [--key KEY] [--speed M/S] [--listen ENDPOINT] [--connect ENDPOINT]
                                   [--deck KEY]

``flightstack fly --target KEY --connect ENDPOINT ...`` lands on this target. The message is
nav_msgs/msg/Odometry in CDR: the pose of the pad's centre in the frame "map" (x east, y north, z up, metres),
and the twist in the robot's own frame. With ``--deck KEY`` the program also sends each message to the
simulator, which moves the simulated pad, so that a simulated vehicle can land on it.
"""

import argparse
import math
import time

from bridge.target.odometry import OdometryPublisher
from bridge.zenoh.zenoh_link import open_session

PERIOD_S = 0.02
RADIUS_M = 1.0
PAD_HEIGHT_M = 0.2  # height of a TurtleBot3 Burger with a pad on top, m

options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
options.add_argument("--key", default="cf1/target/odom")
options.add_argument("--speed", type=float, default=0.1, help="speed along the circle, m/s; 0: at rest")
options.add_argument("--listen", action="append", default=[], help="e.g. tcp/127.0.0.1:7447")
options.add_argument("--connect", action="append", default=[], help="e.g. tcp/127.0.0.1:7448")
options.add_argument("--deck", help="pad of the simulated vehicle, e.g. cf1/sim/target/truth for cf1")
given = options.parse_args()

session = open_session(given.listen, given.connect)
target = OdometryPublisher(session, given.key)
deck = OdometryPublisher(session, given.deck) if given.deck else None
turn_rate_rad_s = given.speed / RADIUS_M
start_s = due_s = time.monotonic()
try:
    while True:
        yaw_rad = turn_rate_rad_s * (time.monotonic() - start_s)
        now_ns = time.time_ns()
        message = target.encode(
            stamp_ns=now_ns,
            position_m=(RADIUS_M * math.sin(yaw_rad), RADIUS_M * (1.0 - math.cos(yaw_rad)), PAD_HEIGHT_M),
            orientation_wxyz=(math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)),
            linear_m_s=(given.speed, 0.0, 0.0),
            angular_rad_s=(0.0, 0.0, turn_rate_rad_s),
        )
        target.put(message, source_time_ns=now_ns)
        if deck is not None:
            deck.put(message, source_time_ns=now_ns)
        due_s += PERIOD_S
        time.sleep(max(0.0, due_s - time.monotonic()))
except KeyboardInterrupt:
    pass
finally:
    session.close()
