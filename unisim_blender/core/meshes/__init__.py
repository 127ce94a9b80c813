"""Meshes that nobody recorded, standing in a drive: models and their files, what rays hit of them,
how they are lit."""
