"""AlpaSim's messages in this package's types: poses, cameras, sweeps, and the addresses of its services.

Needs the package `carla-driver-interface` (the extra ``alpasim``), which brings the compiled messages of AlpaSim's services.
AlpaSim's frames are ours but for two: ``local`` is the world, and ``rig`` lies on the ground below the middle of the rear axle,
x forward, y left, z up.
"""
