"""COCO's annotations of a run's images."""
