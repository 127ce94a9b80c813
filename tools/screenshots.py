"""The documentation's pictures of Blender, from a session of `make test-ui`.

python tools/screenshots.py SHOTS OUT
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

SHOWN = {
    "imported": "import",
    "way": "move",
    "cone": "cone",
    "mesh": "mesh",
    "rendered": "viewport",
    "any_angle": "angle",
    "split_third": "split",
    "difference": "difference",
    "unsupported": "unsupported",
    "sweeps_by_depth": "points",
}
"""By the session's name: the documentation's."""
BESIDE = {"clip": ("unclipped_behind", "clipped_behind")}
"""The documentation's pictures of two views, and the session's names of these."""
VIEW = (0, 50, 1320, 805)
"""Where the 3D view is in the window, without its header: left, top, right, bottom."""
WIDTH = 1200


def main(shots: Path, out: Path) -> None:
    """Smaller, as JPEGs."""
    out.mkdir(parents=True, exist_ok=True)
    for name, shown in SHOWN.items():
        with Image.open(shots / f"{name}.png") as image:
            small = image.convert("RGB").resize(
                (WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS
            )
            small.save(out / f"blender_{shown}.jpg", quality=82, optimize=True)
            print(out / f"blender_{shown}.jpg")
    for shown, names in BESIDE.items():
        views = [Image.open(shots / f"{name}.png").convert("RGB").crop(VIEW) for name in names]
        both = Image.new("RGB", (sum(view.width for view in views), views[0].height))
        for place, view in enumerate(views):
            both.paste(view, (place * view.width, 0))
        both = both.resize((WIDTH, round(both.height * WIDTH / both.width)), Image.Resampling.LANCZOS)
        both.save(out / f"blender_{shown}.jpg", quality=82, optimize=True)
        print(out / f"blender_{shown}.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
