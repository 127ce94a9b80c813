"""A rollout: a driver in a simulation, from its start to a folder with its states, captures, scores and scenario."""
