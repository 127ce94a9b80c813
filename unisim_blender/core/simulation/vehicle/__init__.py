"""The ego vehicle of a simulation: its parameters, how it moves, how it follows a plan, and how it stands on the ground."""
