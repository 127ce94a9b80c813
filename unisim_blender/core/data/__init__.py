"""Common parts of all recorded drives: `log.Log`, its classes, images, cells of sweeps, digests and fingerprints."""
