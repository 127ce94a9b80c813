"""Writes KITTI's raw layout: a drive with its day's calibration."""
