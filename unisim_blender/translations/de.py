"""German texts of the interface, by the English ones."""

GERMAN: dict[str, str] = {}
