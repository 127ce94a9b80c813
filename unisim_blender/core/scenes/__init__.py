"""Trained scenes: opened, loaded onto a device, and how a renderer of them is made."""
