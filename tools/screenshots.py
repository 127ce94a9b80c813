"""The documentation's pictures of Blender, from a session of `make test-ui`.

python tools/screenshots.py SHOTS OUT
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

SHOWN = {"imported": "import", "way": "move", "cone": "cone", "mesh": "mesh", "rendered": "viewport", "any_angle": "angle"}
"""By the session's name: the documentation's."""
WIDTH = 1200


def main(shots: Path, out: Path) -> None:
    """Smaller, as JPEGs."""
    out.mkdir(parents=True, exist_ok=True)
    for name, shown in SHOWN.items():
        with Image.open(shots / f"{name}.png") as image:
            small = image.convert("RGB").resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
            small.save(out / f"blender_{shown}.jpg", quality=82, optimize=True)
            print(out / f"blender_{shown}.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
