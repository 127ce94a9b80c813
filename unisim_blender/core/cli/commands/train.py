"""`unisim train`: a neural scene from a recorded drive."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import click

from ...data.moved import Choice
from ...errors import UnisimError
from ...presets import PRESETS, SignedDistance
from ...training.config import ABLATIONS, GPU_RAYS, RAYS
from ..options import PATH, boxes_option, posed, poses_option


@click.command()
@click.argument("log", type=PATH)
@boxes_option("log")
@click.option("--out", type=PATH, required=True, help="Folder of the trained scene.")
@click.option(
    "--preset",
    default="small",
    show_default=True,
    metavar="NAME",
    help="What is trained: "
    + "; ".join(f"{preset.name}, {preset.about[0].lower()}{preset.about[1:]}" for preset in PRESETS.values())
    + ".",
)
@click.option(
    "--without", metavar="A,B", help=f"Ablations: leave out {', '.join(ABLATIONS)}, as far as the preset has it."
)
@click.option(
    "--density",
    type=click.Choice(get_args(SignedDistance)),
    help="What a signed distance stops. [default: the preset's]",
)
@click.option(
    "--disturb",
    type=(click.FloatRange(min=0.0), click.FloatRange(min=0.0)),
    metavar="METRES DEGREES",
    help="Train on moving actors' boxes with noise, each frame's its own, and tell how much of it refinement has taken back.",
)
@click.option(
    "--cameras", help="Cameras, separated by commas, or all. [default: front_camera, or else the one that looks ahead]"
)
@click.option("--lidars", help="LiDARs, separated by commas, or all. [default: those with a beam table]")
@poses_option("auto")
@click.option("--frames", default="::2", show_default=True, help="START:STOP:STEP.")
@click.option("--width", type=click.IntRange(min=16), help="Width of the images in pixels [default: as recorded].")
@click.option("--minutes", type=float, help="Train this long.")
@click.option(
    "--iterations",
    type=int,
    help="Train this many steps: with fixed threads, always to the same weights, resumed or not.",
)
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda, mps, or auto for the best there is.")
@click.option(
    "--rays",
    type=click.IntRange(min=512),
    help=f"Rays of the cameras in a step. [default: the preset's, or {RAYS}; on cuda {GPU_RAYS}]",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of every random choice.")
@click.option("--vgg", type=click.Path(), help="VGG-16 weights (torchvision's names) for the perceptual term.")
@click.option("--adversarial", is_flag=True, help="Add a patch discriminator on views from shifted origins.")
@click.option("--resume", is_flag=True, help="Go on from the folder's checkpoint.")
@click.option(
    "--preview",
    type=click.FloatRange(min=0.0),
    metavar="SECONDS",
    help="Leave a held-out image, recorded beside rendered, in the folder at most this often, for at most 1 % of the time.",
)
@click.option("--quiet", is_flag=True, help="No progress bar.")
def command(  # noqa: PLR0913
    log: Path, out: Path, preset: str, without: str | None, density: SignedDistance | None,
    disturb: tuple[float, float] | None, cameras: str | None, lidars: str | None, poses: Choice, frames: str,
    width: int | None,
    minutes: float | None, iterations: int | None, device: str, rays: int | None, seed: int, vgg: str | None,
    adversarial: bool, resume: bool, preview: float | None, quiet: bool,
) -> None:  # fmt: skip
    """Train the neural scene of the drive at LOG."""
    from ...data.values import doubts
    from ...formats.readers import open_log
    from ...prepare.selection import camera_ahead, check_names, select_frames, split_names, training_lidars
    from ...scenes.recipe import pick_device
    from ...training.config import TrainConfig, ray_counts, steps_of
    from ...training.loop import train

    picked = pick_device(device, trains=True)
    patches, lidar_rays = ray_counts(picked, rays or (PRESETS[preset].rays if preset in PRESETS else None))
    if minutes is None and iterations is None and preset in PRESETS:
        iterations = steps_of(PRESETS[preset], patches)
    if (minutes is None) == (iterations is None):
        raise click.UsageError("give either --minutes or --iterations")
    if (minutes is not None and not minutes > 0) or (iterations is not None and iterations < 1):
        raise click.UsageError("--minutes and --iterations must be positive")
    recorded = open_log(log)
    available = [c for c in recorded.drive.cameras if recorded.image_frames(c)]
    for sentence in recorded.missing:
        click.echo(f"{log}: {sentence}", err=True)
    if not recorded.drive.actors:
        click.echo(
            f"{log}: the log has no boxes, so everything in it is trained as if it stood still: what moves is blurred or left "
            "out, and no actor can be moved, removed or measured; unisim track finds boxes",
            err=True,
        )
    chosen = tuple(recorded.drive.lidars) if lidars == "all" else split_names(lidars) or training_lidars(recorded)
    check_names("--lidars", chosen, recorded.drive.lidars)
    for name, lidar in recorded.drive.lidars.items():
        if not lidar.model.beams:
            what = "is trained on and cannot be simulated" if name in chosen else "is left out: --lidars takes it"
            click.echo(f"{log}: {name} has no beam table, so it {what}", err=True)
    if not available:
        raise UnisimError(f"{log}: has no images to train on")
    names = tuple(available) if cameras == "all" else split_names(cameras or camera_ahead(recorded)) or ()
    check_names("--cameras", names, available)
    for sentence in doubts(recorded, names, chosen):
        click.echo(sentence, err=True)
    recorded = posed(recorded, poses, quiet)
    config = TrainConfig(
        cameras=names, lidars=chosen, frames=select_frames(frames, recorded.drive.frames), width=width,
        preset=preset, without=split_names(without) or (), density=density, disturb=disturb, minutes=minutes,
        iterations=iterations, device=picked, seed=seed, vgg=vgg, adversarial=adversarial, preview_s=preview,
        patches=patches, lidar_rays=lidar_rays,
    )  # fmt: skip
    header = train(recorded, config, out, resume=resume, quiet=quiet)
    click.echo(f"{out}: {header.training['iterations']} steps in {header.training['seconds'] / 60:.1f} minutes")
    if disturb is not None:
        from ...evaluation.tracklets import in_words

        click.echo(in_words(header, recorded.drive))
