"""The ego vehicle."""
