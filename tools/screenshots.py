"""The documentation's pictures of Blender, from a session of `make test-ui`.

python tools/screenshots.py SHOTS OUT
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

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
BESIDE = {
    "clip": ("unclipped_behind", "clipped_behind"),
    "lens": ("lens_ncore_solid", "street_ncore_wide_rendered"),
}
"""The documentation's pictures of two views, and the session's names of these."""
LAYOUTS = {
    "pandaset": "PandaSet", "ncore": "NVIDIA NCore", "argoverse2": "Argoverse 2",
    "nuscenes": "nuScenes", "kitti": "KITTI", "waymo": "Waymo Open",
}  # fmt: skip
"""By the session's names of layouts: what the sheet of the street in each of them calls them, two in a row."""
VIEW = (0, 50, 1320, 805)
"""Where the 3D view is in the window, without its header: left, top, right, bottom."""
WIDTH, TITLE = 1200, 22
"""Of the pictures, and the height of a sheet's titles, pixels."""


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
    if all((shots / f"street_{name}_rendered.png").is_file() for name in LAYOUTS):
        sheet(shots).save(out / "blender_layouts.jpg", quality=78, optimize=True)
        print(out / "blender_layouts.jpg")


def sheet(shots: Path) -> Image.Image:
    """The street from each layout: the imported boxes over the recorded image, and what is rendered, side by side."""
    width = WIDTH // 4
    height = round(width * (VIEW[3] - VIEW[1]) / (VIEW[2] - VIEW[0]))
    whole = Image.new("RGB", (WIDTH, 3 * (height + TITLE)), (30, 30, 30))
    pen = ImageDraw.Draw(whole)
    for number, (name, title) in enumerate(LAYOUTS.items()):
        left, top = number % 2 * 2 * width, number // 2 * (height + TITLE)
        pen.text((left + 6, top + 3), title, fill=(235, 235, 235), font=ImageFont.load_default(size=TITLE - 8))
        for side, what in enumerate(("solid", "rendered")):
            with Image.open(shots / f"street_{name}_{what}.png") as image:
                view = image.convert("RGB").crop(VIEW).resize((width, height), Image.Resampling.LANCZOS)
            whole.paste(view, (left + side * width, top + TITLE))
    return whole


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
