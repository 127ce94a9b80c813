"""A driver on rendered sensors beside the same loop on a street's exact ones."""
