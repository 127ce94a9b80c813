"""How a scenario is simulated, as its document states it."""
