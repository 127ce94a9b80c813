"""A run as an MCAP file of Foxglove's messages."""
