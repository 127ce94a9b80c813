"""Recorded images warped to where a camera is, over surfels (after Free View Synthesis, Riegler and
Koltun, ECCV 2020)."""
