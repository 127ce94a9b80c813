"""Which space a recording shows, and what lies in the space that it does not show."""
