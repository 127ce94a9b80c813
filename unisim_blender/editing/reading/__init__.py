"""A sampled scene read as a scenario: its difference from the recorded drive."""
