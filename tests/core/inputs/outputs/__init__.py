"""Files that the program writes, and those that it keeps to save work, with faults."""
