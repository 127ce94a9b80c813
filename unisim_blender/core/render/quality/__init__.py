"""What may be saved, and errors that are bounded."""
