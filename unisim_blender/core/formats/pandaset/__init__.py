"""PandaSet: its files read and written."""
