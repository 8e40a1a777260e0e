"""ROS 2 on Zenoh: names, nodes, CDR of its messages."""
