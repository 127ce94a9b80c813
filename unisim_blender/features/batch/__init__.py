"""Batches: many variants and values of parameters in one run."""
