"""NVIDIA NCore V4: its sequences read and written, through NVIDIA's package `nvidia-ncore` (the extra `ncore`)."""
