"""Simulations: a driver in the closed loop of a scene, and the rollouts that come of it."""
