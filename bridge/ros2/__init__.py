"""ROS 2 over Zenoh: names, nodes, and the CDR encoding of messages."""
