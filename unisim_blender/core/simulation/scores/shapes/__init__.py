"""Shapes in the world's plane that scores are made of: turned boxes, when they meet, and the recorded path."""
