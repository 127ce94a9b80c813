"""Drivers beside each other in the closed loop of one scenario: their scores as a table, and whether bytes repeat."""
