"""Actors: copied, inserted, replaced, made of meshes."""
