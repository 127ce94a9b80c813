"""Finished runs in formats that others' tools open: MCAP, ROS 2 bags, COCO's annotations."""
