"""What a training step learns from: patches of images and rays of sweeps."""
