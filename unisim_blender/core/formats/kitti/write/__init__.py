"""Writes KITTI's layouts: raw drives with their day's calibration, and sequences of the tracking benchmark."""
