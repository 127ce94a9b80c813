"""Reports of the measurements, as files, tables and plots."""
