"""UniSim in Blender. Blender is imported when the add-on is registered: the package is an ordinary one besides, with
the command line `unisim` in `core`."""

from importlib import import_module


def register() -> None:
    """Add everything to Blender."""
    # by name, so that importing core imports nothing of Blender's side
    import_module(".addon", __package__).register()


def unregister() -> None:
    """Take everything away again, and end the worker."""
    import_module(".addon", __package__).unregister()
