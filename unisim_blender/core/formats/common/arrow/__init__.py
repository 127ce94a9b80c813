"""Tables of Apache Arrow's files. Needs pyarrow, an optional package that is imported where a file is read."""
