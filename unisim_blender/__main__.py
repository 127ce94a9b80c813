"""``python -m unisim_blender``: the command line without its console script."""

from unisim_blender.core.cli import main

if __name__ == "__main__":
    main()
