"""ASAM OpenSCENARIO XML: drives as version 1.3, and the storyboards of any 1.x back as edits.

World positions are the world's, and time 0 is the log's first frame. An entity's reference point is on the ground below its rear
axle, or below its middle where it has none; its bounding box says where its box lies from there.
"""
