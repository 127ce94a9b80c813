"""Batches of a training step: patches of images and rays of sweeps."""
