"""The service `sensorsim` of AlpaSim, and of NVIDIA's NuRec renderer: images and sweeps of opened scenes, for a simulator that
decides where everything is. Needs `carla-driver-interface` (the extra ``alpasim``)."""
