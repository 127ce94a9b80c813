"""Recorded images of single actors: the best views, thumbnails, paint colours, and names with these."""
