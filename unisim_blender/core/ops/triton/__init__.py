"""Kernels for GPUs, in Triton's language: what torch's own operations do on a GPU, with nothing written in between.

grid.py      points to encodings, forward and backward; points to what a field says
propose.py   occupied voxels along rays to places of samples
gather.py    weights, features and depths along ray segments, forward and backward

A kernel starts on the device of its tensors, which need not be the current one. Each gives what a function of plain torch gives,
which is its specification; `ready.py` says where they apply.
"""
