"""The stages of `benchmarks/gpu.py`: each runs in a process of its own, so that a fault on the GPU ends that one alone.

settings.py  what a stage is told, and where it leaves what it found
machine.py   what it is measured on; the native library
street.py    a street's log
kernels.py   the kernels of training beside torch: how values and gradients are held against each other
cases.py     what each kernel is given
scenes.py    trainings
times.py     images and sweeps of the tracer without torch; by torch, and steps, by CUDA's events, with and without kernels
profiles.py  what steps and an image spend their time on
"""
