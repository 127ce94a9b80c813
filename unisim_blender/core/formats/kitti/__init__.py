"""KITTI: raw drives and tracking sequences."""
