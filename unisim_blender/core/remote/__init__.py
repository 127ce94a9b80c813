"""Inputs by URL: copies of them on this machine, and the requests that fetch them."""
