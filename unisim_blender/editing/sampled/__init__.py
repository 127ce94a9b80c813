"""A sampled scene: what stands where at which frames, its poses, scales, sensor mounts and recorded drive."""
