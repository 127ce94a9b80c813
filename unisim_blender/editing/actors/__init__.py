"""The list of actors: filter, rows, cards, names and images."""
