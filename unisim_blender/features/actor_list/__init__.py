"""The list of actors and the presence timeline."""
