"""What `unisim info` of a long drive costs in each layout: seconds of processors and memory, and of one image and one sweep.

python benchmarks/long_layouts.py FOLDER [--frames 1000] [NAME...]

FOLDER/NAME is a drive in a layout (`long_logs`), made where it is not there: a few sweeps and one image, linked again and again,
and 60 boxes a frame. What is measured runs in a process of its own; PandaSet's layout and NCore are `long_drive.py`'s.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from long_drive import INFO, USED, measured
from long_logs import argoverse2, kitti, nuscenes, waymo

LAYOUTS: dict[str, Callable[[Path, int], Path]] = {
    "argoverse2": argoverse2.write,
    "kitti": kitti.write,
    "nuscenes": nuscenes.write,
    "waymo": waymo.write,
}
READ = (
    USED
    + """
from unisim_blender.core.formats.readers import open_log

log = open_log(sys.argv[1])
found = {"opened": now()}
camera, lidar = next(iter(log.drive.cameras)), next(iter(log.drive.lidars))
middle = log.drive.frames[len(log.drive.frames) // 2]
log.image(camera, middle)
found["one image"] = now()
log.sweep(lidar, middle)
found["one sweep"] = now()
log.sweep_grid(lidar, middle)
found["its grid"] = now()
print(json.dumps(found), file=sys.stderr)
"""
)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, type=click.Choice(sorted(LAYOUTS)))
@click.option("--frames", default=1000, show_default=True)
def main(folder: Path, names: tuple[str, ...], frames: int) -> None:
    """Make long drives in FOLDER and measure on them; of all layouts where none is named."""
    for name in names or LAYOUTS:
        place = folder / name / "path.txt"
        if not place.exists():
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(str(LAYOUTS[name](place.parent / "written", frames).relative_to(place.parent)))
        log = place.parent / place.read_text()
        os.environ["UNISIM_CACHE"] = str(folder / name / "cache")
        shutil.rmtree(folder / name / "cache", ignore_errors=True)
        for run in ("the first time", "again"):
            printed, used = measured(INFO, "info", str(log), "--json")
            about = json.loads(printed)
            click.echo(f"{name}, {run}: " + ", ".join(f"{key} {value:.2f}" for key, value in used["info"].items()))
        total = sum(count["moving"] + count["still"] for count in about["actors"].values())
        images = sum(camera["images"] for camera in about["cameras"].values())
        sweeps = sum(lidar["sweeps"] for lidar in about["lidars"].values())
        click.echo(f"  {len(about['frames'])} frames, {images} images, {sweeps} sweeps, {total} actors")
        for what, of in measured(READ, str(log))[1].items():
            click.echo(f"  {what}: " + ", ".join(f"{key} {value:.2f}" for key, value in of.items()))


if __name__ == "__main__":
    main()
