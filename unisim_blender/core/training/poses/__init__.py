"""Poses that training corrects: cameras' and actors'."""
