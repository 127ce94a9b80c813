"""nuScenes v1.0: its JSON tables, key frames and sweeps."""
