"""Triton's kernels, a module for each operation that has some; `dispatch` imports them where Triton runs."""
