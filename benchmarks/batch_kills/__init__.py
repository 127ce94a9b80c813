"""A batch on Ray whose workers, nodes and command are killed at random: ``python -m benchmarks.batch_kills``."""
