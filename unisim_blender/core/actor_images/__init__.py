"""Recorded images of single actors: where each is seen best, cut out, the colour of its paint, and a
name made of that."""
