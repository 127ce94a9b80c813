"""``python -m unisim_blender``: the command line without its console script; it also renders .blend files."""

import sys
from pathlib import Path

from unisim_blender.core.cli.main import main

if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments[:1] == ["render"] and arguments[1:2] and arguments[1].endswith(".blend"):
        from unisim_blender.headless import render_file

        sys.exit(render_file(Path(arguments[1]), arguments[2:]))
    main()
