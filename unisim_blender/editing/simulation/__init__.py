"""Simulations of a drive: how they are stated, what a rollout left, and how another one goes on from it."""
