"""How much of wires, masts, railings and fences a trained scene shows, in replayed and in shifted views of a street.

unisim synth STREET --thin --width 640 --height 360
unisim train STREET SCENE --width 640
python benchmarks/thin_things.py STREET SCENE [--shift 0 --shift 2] [--frames 3,9,15] [--out DIR]

The street is drawn with its thin things and without. A pixel that they cover by a quarter or more, and change visibly, is
recalled where the scene's colour is nearer to the street with them. Elsewhere, within five pixels, a pixel is false where the
scene's colour differs from the street's as a thin thing would. A pixel of the sky is stopped where the scene's depth is less
than `SKY_M`: a sheet of the sky's colour, which hides wires from beside the path.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation

from unisim_blender.core.geometry import make_pose
from unisim_blender.core.render.captures import render_image, states_of
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Camera
from unisim_street.street import build_street, load_street
from unisim_street.truth import exact_image, make_world, thin_share

COVERED, VISIBLE, BESIDE_PX, SKY_M = 0.25, 0.08, 5, 80.0


def shifted(camera: Camera, metres: float) -> Camera:
    """Return the camera moved to its right."""
    aside = make_pose(np.array([metres, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    return replace(camera, world_from_camera=camera.world_from_camera.transformed(right=aside))


@click.command()
@click.argument("log", type=click.Path(exists=True, path_type=Path))
@click.argument("scene", type=click.Path(exists=True, path_type=Path))
@click.option("--camera", "name", default="front_camera", show_default=True)
@click.option("--width", default=640, show_default=True)
@click.option("--frames", default="3,9,15", show_default=True)
@click.option("--shift", "shifts", multiple=True, type=float, default=(0.0, 2.0), show_default=True, help="Metres.")
@click.option("--out", type=click.Path(path_type=Path), help="Where images go: truth, scene, mask.")
def main(
    log: Path, scene: Path, name: str, width: int, frames: str, shifts: tuple[float, ...], out: Path | None
) -> None:
    """Print recall and false pixels of the SCENE that was trained on the street LOG, for each shift."""
    street = load_street(log)
    r = street.recipe
    if not street.thin:
        raise click.UsageError(f"{log} has no thin things: write it with unisim synth --thin")
    plain = build_street(r.seed, r.frames, r.width, r.height, r.cameras, lens=r.lens, speed_m_s=r.speed_m_s,
                         turns_deg=r.turns_deg, kind=r.kind, people=r.people)  # fmt: skip
    renderer = Renderer(CompiledBackend(CompiledScene(scene), QUALITIES["balanced"]))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    for metres in shifts:
        covered = recalled = beside = false = sky = stopped = 0
        for frame in (int(part) for part in frames.split(",")):
            recorded = street.drive.cameras[name]
            camera = replace(shifted(recorded, metres), model=recorded.model.resized(width))
            time_s = camera.time_s[frame]
            world, without = make_world(street, street.drive), make_world(plain, plain.drive)
            exact = exact_image(world, camera, time_s)
            true, bare = exact.rgb, exact_image(without, camera, time_s).rgb
            share = thin_share(world, street.thin, camera, time_s, samples=2)
            drive = replace(street.drive, cameras={**street.drive.cameras, name: camera})
            states = states_of(renderer, drive)
            image = render_image(renderer, states, Capture.of_frame(states.camera(name), frame), ("rgb", "depth"))
            shown, depth_m = image.rgb, image.depth_m
            assert exact.depth_m is not None and depth_m is not None
            far = np.abs(true - bare).max(-1)
            mask = (share >= COVERED) & (far > VISIBLE)
            nearer = np.abs(shown - true).sum(-1) < np.abs(shown - bare).sum(-1)
            near = binary_dilation(share > 0, iterations=BESIDE_PX) & (share == 0)
            covered, recalled = covered + mask.sum(), recalled + (mask & nearer).sum()
            wrong = near & (np.abs(shown - true).max(-1) > np.median(far[mask]) if mask.any() else False)
            beside, false = beside + near.sum(), false + wrong.sum()
            open_air = ~np.isfinite(exact.depth_m) & (share == 0)
            sky, stopped = sky + open_air.sum(), stopped + (open_air & (depth_m < SKY_M)).sum()
            if out is not None:
                marked = np.where(mask[..., None], np.where(nearer[..., None], [0, 1, 0], [1, 0, 0]), true)
                both = np.concatenate([true, shown, marked], 1)
                Image.fromarray(np.round(both * 255).astype(np.uint8)).save(out / f"{metres:+.1f}m-{frame:03d}.png")
        print(
            f"{metres:+.1f} m: {100 * recalled / max(covered, 1):.1f} % of {covered} pixels recalled, "
            f"{100 * false / max(beside, 1):.1f} % of {beside} beside them false, "
            f"{100 * stopped / max(sky, 1):.1f} % of the sky stopped before {SKY_M:g} m"
        )


if __name__ == "__main__":
    main()
