"""Vehicle detectors in LiDAR and camera frames, and what they tell of simulated ones: python -m
benchmarks.detection --help."""
