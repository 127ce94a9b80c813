"""Writes nuScenes v1.0: tables of one scene, sweeps with every firing, images."""
