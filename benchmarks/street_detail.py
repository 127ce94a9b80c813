"""How fine a static field is along streets of several lengths and shapes: colours of surfaces, learnt from points of them.

python benchmarks/street_detail.py [--only NAME] [--preset tiny] [--steps-per-m 4]

A field is shown colours at points of the street's surfaces, as many steps a metre on each street, and asked at others: what
differs between streets is then what its volume and its tables do. Each street is measured with the preset's own tables in the box
of its way from end to end (as ordinary drives have them), and as a training makes them. Beside it stands how much of what is seen
within 80 m lies in the box.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from unittest import mock

import click
import numpy as np
import torch
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray, invert_pose, transform_points
from unisim_blender.core.model import volume as volume_module
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.fields import StaticField
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.ops.devices import torch_threads
from unisim_blender.core.presets import preset as preset_of
from unisim_blender.core.training.seeding import sized
from unisim_street.layout import FRAME_S
from unisim_street.street import Street, build_street
from unisim_street.tracing.surface_hits import look_up
from unisim_street.tracing.trace import make_bundles, trace
from unisim_street.truth import make_world

SPEED_M_S = 20.0
STREETS: dict[str, tuple[float, tuple[float, ...]]] = {
    "125 m": (125.0, ()),
    "250 m": (250.0, ()),
    "300 m, turn of 90°": (300.0, (90.0,)),
    "1000 m": (1000.0, ()),
    "1000 m, turn of 90°": (1000.0, (90.0,)),
    "1000 m, winding": (1000.0, (90.0, -90.0, 60.0)),
}
EVERY_M, RAYS, BUNDLE = 8.0, 2048, 32
SEEN_M = 80.0
BATCH = 2048
PARTS = 10
FOOTPRINT_RAD = 0.001
"""Of a ray: what is finer is not in the colours."""


@dataclass(frozen=True)
class Seen:
    """Points (N, 3) in the drive's world, their colours (N, 3), and how far along the drive each was seen from (N,), 0 to 1."""

    points: FloatArray
    colours: FloatArray
    along: FloatArray


def seen_from(street: Street) -> Seen:
    """What rays in all directions, sixty degrees up at most, meet of the street from places along its drive."""
    drive = street.drive
    world = make_world(street, drive)
    placements = world.placements[: world.first_actor]
    times = np.array([drive.time_s[frame] for frame in drive.frames])
    count = max(2, round(np.ptp(times) * SPEED_M_S / EVERY_M))
    rng = np.random.default_rng(7)
    parts = []
    for i, pose in enumerate(drive.world_from_ego.at(np.linspace(times[0], times[-1], count))):
        turn = np.sort(rng.uniform(-np.pi, np.pi, RAYS)).reshape(-1, BUNDLE)
        up = np.radians(rng.uniform(-25.0, 60.0, RAYS)).reshape(-1, BUNDLE)
        directions = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], -1)
        origins = np.broadcast_to(pose[:3, 3] + drive.world_origin + [0.0, 0.0, 1.8], directions.shape)
        moments = np.zeros(directions.shape[:2])
        hits = trace(placements, make_bundles(origins, directions, moments))
        hits.t[hits.t > SEEN_M] = np.inf
        flat = origins.reshape(-1, 3), directions.reshape(-1, 3), moments.reshape(-1)
        found = look_up(placements, hits, *flat, FOOTPRINT_RAD)
        parts.append((found.points - drive.world_origin, found.albedo, np.full(len(found.points), i / count)))
    return Seen(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def learn(config: ModelConfig, volume: Volume, seen: Seen, held: NDArray[np.bool_], steps: int) -> FloatArray:
    """Return the mean squared errors (M,) of colours at the points that are ``held`` back, of a field that learnt the others."""
    torch.manual_seed(0)
    field = StaticField(config, volume)
    local = transform_points(invert_pose(volume.world_from_volume), seen.points)
    inside = ((local > 0) & (local < volume.size_m)).all(1)
    x, colours = torch.as_tensor(local).float(), torch.as_tensor(seen.colours).float().sqrt()
    shown = torch.as_tensor(np.flatnonzero(inside & ~held))
    groups = [
        {"params": list(field.grid.parameters()), "rates": (1e-2, 1e-3), "eps": 1e-15},
        {"params": list(field.network.parameters()), "rates": (5e-3, 3e-4), "eps": 1e-10},
    ]
    optimiser = torch.optim.Adam(groups, lr=1e-3, betas=(0.9, 0.99), fused=True)
    generator = torch.Generator().manual_seed(1)

    def colour(places: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(field(places)[1][:, :3])

    for step in range(steps):
        for group in optimiser.param_groups:
            first, last = group["rates"]
            group["lr"] = min(1.0, (step + 1) / 100) * first * (last / first) ** (step / steps)
        rows = shown[torch.randint(len(shown), (BATCH,), generator=generator)]
        loss = (colour(x[rows]) - colours[rows]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        asked = torch.as_tensor(np.flatnonzero(inside & held))
        errors = (colour(x[asked]) - colours[asked]).square().mean(1)
    found = np.full(int(held.sum()), np.nan)
    found[inside[held]] = errors.double().numpy()
    return found


def db(errors: FloatArray) -> float:
    """PSNR of mean squared errors, those that are no number left out."""
    return float(-10 * np.log10(np.nanmean(errors)))


@click.command()
@click.option("--only", multiple=True, type=click.Choice(list(STREETS)), help="Of the streets.")
@click.option("--preset", default="tiny", show_default=True)
@click.option("--steps-per-m", default=4.0, show_default=True)
@click.option("--seed", default=0, show_default=True, help="Of the streets.")
def main(only: tuple[str, ...], preset: str, steps_per_m: float, seed: int) -> None:
    """Print a row for each street, as ordinary drives are trained and as this drive is."""
    usual = preset_of(preset).model
    for name in only or STREETS:
        metres, turns = STREETS[name]
        frames = round(metres / SPEED_M_S / FRAME_S) + 1
        street = build_street(seed, frames, 64, 36, speed_m_s=SPEED_M_S, turns_deg=turns)
        seen = seen_from(street)
        held = np.random.default_rng(8).random(len(seen.points)) < 0.1
        with mock.patch.object(volume_module, "WINDING_M", np.inf):
            before = usual, Volume.along(street.drive)
        after = sized(usual, street.drive, Volume.along(street.drive)), Volume.along(street.drive)
        for what, (config, volume) in {"ordinary": before, "as trained": after}.items():
            if what == "as trained" and config is usual and np.array_equal(volume.size_m, before[1].size_m):
                click.echo(f"{name}, as trained: the same")
                continue
            begun = time.process_time()
            with torch_threads(1):
                errors = learn(config, volume, seen, held, max(1, round(metres * steps_per_m)))
            part = (seen.along[held] * PARTS).astype(int)
            tenths = [db(errors[part == i]) for i in range(PARTS)]
            inside = [float(np.isfinite(errors[part == i]).mean()) for i in range(PARTS)]
            cells = np.prod(np.ceil(volume.size_m / config.voxel_m)) / 1e6
            click.echo(
                f"{name}, {what}: 2^{config.static_grid.log2_table} rows, {db(errors):.2f} dB (tenths {min(tenths):.2f} to "
                f"{max(tenths):.2f}), in the box {np.mean(inside):.3f} (least tenth {min(inside):.3f}), "
                f"{' x '.join(f'{edge:.0f}' for edge in volume.size_m)} m, {cells:.0f} M voxels, "
                f"{(time.process_time() - begun) / metres / steps_per_m * 1e3:.1f} ms a step"
            )


if __name__ == "__main__":
    main()
