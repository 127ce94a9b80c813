"""The command line `unisim`."""
