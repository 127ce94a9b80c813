"""The commands of ``unisim``, one a module, each a click command named ``command``.

A module here stays cheap to import, for ``unisim --help`` imports them all: torch and what needs it are imported inside
the command's function.
"""
