"""Waymo Open, perception dataset v2 (Parquet)."""
