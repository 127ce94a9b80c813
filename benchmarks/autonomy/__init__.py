"""The stack of `examples/perception`, open loop, on a log's sensors: recorded, replayed, shifted to the side, and exact."""
