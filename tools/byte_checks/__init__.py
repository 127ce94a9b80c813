"""What `tools/compare_bytes.py` is made of: cases, the two trees that run them, differences between files."""
