"""Pictures of two versions of the extension beside each other, for the documentation, from a session of
the window's tests.

tests/ui/run.py ROOT RELEASE BEFORE before_after --extension OLD.zip
tests/ui/run.py ROOT RELEASE AFTER before_after
python tools/before_after.py BEFORE AFTER OUT
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image

Box = tuple[int, int, int, int]
FRAME: Box = (337, 235, 985, 603)
"""Where the camera's frame is in the window: left, top, right, bottom."""
WHOLE: Box = (0, 0, 1600, 900)
VIEW: Box = (30, 30, 1320, 900)
SHOWN: dict[str, tuple[tuple[str, ...], Box, int]] = {
    "edited": (("edited",), FRAME, 640),
    "shifted": (("shifted",), FRAME, 640),
    "moved": (("moved_at_once", "pictures_moved"), (0, 60, 1320, 900), 800),
    "retimed": (("retimed_solid_at_once", "retimed_rendered_at_once"), (100, 50, 1320, 900), 720),
    "followed": (("pictures_followed",), (400, 200, 1320, 840), 800),
    "opened_file": (("pictures_opened_file",), (860, 30, 1600, 900), 640),
    "first_import": (("pictures_first_import",), WHOLE, 1100),
    "clicked": (("clicked_once", "pictures_clicked"), (20, 60, 1320, 820), 800),
    "log_alone": (("pictures_log_alone",), VIEW, 900),
    "tooltip_alone": (("tooltip_log_alone",), (900, 480, 1600, 880), 640),
    "tooltip_snap": (("tooltip_snap",), (1000, 300, 1600, 600), 640),
    "panels": (("pictures_panels",), (1040, 30, 1320, 806), 420),
    "scaled": (("pictures_scaled",), (260, 60, 1320, 760), 800),
    "outside": (("pictures_outside",), (30, 50, 1010, 640), 760),
    "from_outside": (("pictures_from_outside",), (0, 50, 1040, 810), 700),
    "aside": (("pictures_aside",), (150, 50, 1320, 900), 800),
    "deleted_ego": (("deleted_ego_at_once",), (150, 400, 1320, 900), 900),
    "points": (("pictures_points",), VIEW, 800),
}
"""By the name in the documentation: the session's pictures, one below the other, which part of the
window, and how wide."""
RENDERS = ("edited", "shifted")
"""Of these, what `unisim render` makes of the same scenario is shown, too."""
MOST_BYTES = 120_000


def main(before: Path, after: Path, out: Path) -> None:
    """Crop, shrink and write all pictures."""
    out.mkdir(parents=True, exist_ok=True)
    for name, (shots, box, width) in SHOWN.items():
        for version, folder in (("before", before), ("after", after)):
            parts = [Image.open(folder / f"{shot}.png").convert("RGB").crop(box) for shot in shots]
            write(stacked(parts, width), out / f"{name}_{version}.jpg")
    for name in RENDERS:
        with Image.open(after / f"{name}_render.png") as image:
            write(image.convert("RGB"), out / f"{name}_render.jpg")


def stacked(parts: list[Image.Image], width: int, gap: int = 8) -> Image.Image:
    """Return pictures of one size below each other, ``width`` pixels wide."""
    small = [part.resize((width, round(part.height * width / part.width)), Image.Resampling.LANCZOS) for part in parts]
    height = small[0].height
    whole = Image.new("RGB", (width, len(small) * (height + gap) - gap), "white")
    for row, part in enumerate(small):
        whole.paste(part, (0, row * (height + gap)))
    return whole


def write(image: Image.Image, path: Path) -> None:
    """Write a JPEG, as good as its size allows."""
    for quality in range(88, 40, -4):
        data = io.BytesIO()
        image.save(data, "JPEG", quality=quality, optimize=True, progressive=True)
        if data.tell() < MOST_BYTES:
            break
    path.write_bytes(data.getvalue())
    print(path, f"{data.tell() // 1000} kB")


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:4]))
