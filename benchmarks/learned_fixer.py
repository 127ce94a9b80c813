"""Train and test the network of `--fill learned`, on views of procedural streets beside their ground truth.

    unisim synth out/streetN --kind curve --seed N --frames 40 --edits
    unisim train out/streetN --out out/sceneN --preset small --frames ::2 --width 480 --iterations 1500
    python -m benchmarks.learned_fixer pairs out/streetN out/sceneN out/pairs
    python -m benchmarks.learned_fixer train out/pairs --out unisim_blender/core/render/learned_fixer.npz
    python -m benchmarks.learned_fixer test out/pairs-of-other-streets

A pair is a view with the parked cars removed or moved aside, as a fixer is given it, with the street's exact image. The
network shipped was trained on a curve (seeds 3 and 6), a crossing (4) and a night (2).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.render.captures import CaptureStates, render_image, states_of
from unisim_blender.core.render.fixers import ImageToFix, RecordedFixer
from unisim_blender.core.render.learned_fixer import COARSEST, LEVELS, SLOPE, added, network_input, part_of
from unisim_blender.core.render.observed_space import Observing
from unisim_blender.core.render.recorded_depth import recorded_depth
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.traced_planes import plane_fill
from unisim_blender.core.render.tracer import Array
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.training.losses.terms import SSIM_WINDOW, gaussian_mean, similarity
from unisim_blender.core.world.captures import Capture
from unisim_street.street import load_street, street_of
from unisim_street.truth import truth_camera

CHANNELS, INPUTS = (16, 32, 56, 80), 16
SHIFTS_M = (-3.0, 2.0, 3.0, 4.0)
LEAST_PIXELS = 200
"""Views with fewer never-seen pixels are left out."""
CROP, BATCH, RATE = 80, 6, 6e-4
EXPOSURE = 0.15
"""Deviation of the logarithm of random gains of red, green and blue."""
RED = (0, 8, 12)
"""Channels of the input at which colours begin."""


views: list[ImageToFix] = []


def keep(view: ImageToFix) -> Array:
    """Change no image, and keep what a fixer is given."""
    views.append(view)
    return view.image


class Block(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.a, self.b = nn.Conv2d(inputs, outputs, 3, padding=1), nn.Conv2d(outputs, outputs, 3, padding=1)
        self.k = nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        return F.leaky_relu(self.b(F.leaky_relu(self.a(x), SLOPE)) + self.k(x), SLOPE)


class FillNetwork(nn.Module):
    """The network of `unisim_blender.core.render.learned_fixer`."""

    def __init__(self) -> None:
        super().__init__()
        self.d = nn.ModuleList(Block(*sizes) for sizes in zip((INPUTS, *CHANNELS), CHANNELS, strict=False))
        self.u = nn.ModuleList(
            Block(coarse + fine, fine) for coarse, fine in zip(CHANNELS[:0:-1], CHANNELS[-2::-1], strict=True)
        )
        self.o = nn.Conv2d(CHANNELS[0], 3, 3, padding=1)
        for name, values in self.named_parameters():
            if values.ndim == 1:
                nn.init.zeros_(values)
                continue
            nn.init.kaiming_normal_(values, a=SLOPE)
            # both branches of a block together keep the variance, and the first result is nearly the image
            values.data *= 0.01 if name.startswith("o") else 1.0 if ".a." in name else 0.7

    def forward(self, x: Tensor) -> Tensor:
        """Return what is added to the colours (N, 3, H, W) of inputs (N, 16, H, W)."""
        height, width = x.shape[-2:]
        y, finer = F.pad(x, (0, -width % COARSEST, 0, -height % COARSEST), mode="replicate"), []
        for level, block in enumerate(self.d):
            y = block(y)
            if level < LEVELS - 1:
                finer.append(y)
                y = F.avg_pool2d(y, 2)
        for block in self.u:
            y = block(torch.cat([F.interpolate(y, scale_factor=2, mode="nearest"), finer.pop()], 1))
        return self.o(y)[..., :height, :width]


def fixed(network: FillNetwork, x: Tensor) -> Tensor:
    """Return the images (N, 3, H, W) of inputs, fixed by their weights; `learned_fixer.part_of` is left to rendering."""
    return x[:, :3] + x[:, 3:4] * network(x)


def box_mean(x: Tensor) -> Tensor:
    """Return means (N, 3, H, W) of 5 x 5 pixels, which cost less than Gaussian ones."""
    return F.avg_pool2d(x, 5, 1, 2)


SAME_SIZE_MEAN = partial(gaussian_mean, padding=SSIM_WINDOW // 2)
"""The means of SSIM, as many as there are pixels."""


def distances(a: Tensor, b: Tensor, mean: Callable[[Tensor], Tensor] = SAME_SIZE_MEAN) -> Tensor:
    """Return 1 - SSIM plus differences of gradients (N, 1, H, W) of images (N, 3, H, W)."""
    across, down = ((a.diff(dim=axis) - b.diff(dim=axis)).abs() for axis in (-1, -2))
    return (1 - similarity(a, b, mean) + F.pad(across, (0, 1)) + F.pad(down, (0, 0, 0, 1))).mean(1, keepdim=True)


def read_pairs(folder: Path) -> Iterator[tuple[str, Tensor, Tensor]]:
    """Yield name, input (16, H, W) and exact image (3, H, W) of pairs."""
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as pair:
            given, exact = (
                torch.from_numpy(pair[key].astype(np.float32)).permute(2, 0, 1) for key in ("input", "exact")
            )
        yield path.stem, given, exact


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def main() -> None:
    """Train and test the network of `--fill learned`."""


@main.command()
@click.argument("street", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("scene", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--every", default=2, show_default=True, help="Every how many frames, from frame 1 on.")
@click.option("--width", default=240, show_default=True, help="Of the images, pixels.")
def pairs(street: Path, scene: Path, out: Path, every: int, width: int) -> None:
    """Write pairs of a SCENE of a STREET to the folder OUT; what is there is kept."""
    out.mkdir(parents=True, exist_ok=True)
    known, log, opened = street_of(load_street(street), {}), open_log(street), open_scene(scene)
    backend = load_backend(opened, {}, "balanced", "cpu")
    assert isinstance(backend, Observing)
    depth, fill = recorded_depth(backend, backend.observed[0]), plane_fill(backend)
    parked = [uid for uid, actor in log.drive.actors.items() if actor.label == "Car" and not actor.is_moving]
    cases: dict[str, list[dict[str, Any]]] = {"removed": [{"type": "remove", "actor": uid} for uid in parked]}
    cases |= {f"aside{metres:+g}": [{"type": "ego", "shift_left_m": metres}] for metres in SHIFTS_M}
    camera = opened.header.training["cameras"][0]
    for case, edits in cases.items():
        with TemporaryDirectory() as folder:
            file = Path(folder) / "scenario.json"
            document = {"format": "unisim-scenario", "version": 1, "name": case, "log": str(street.resolve())}
            file.write_text(json.dumps({**document, "edits": edits}))
            edited = prepare_scenario(file, scene=scene).edited
            exact_drive = prepare_scenario(file, refined=False).edited
        fixer = RecordedFixer(f"{__name__}:{keep.__name__}", log, edited.cameras)
        renderer = Renderer(backend, recorded_depth=depth, fill=fill, fixer=fixer)
        states: CaptureStates = states_of(renderer, edited)
        for frame in edited.frames[1::every]:
            path = out / f"{street.name}-{case}-{frame}.npz"
            if path.exists():
                continue
            views.clear()
            render_image(renderer, states, Capture.of_frame(states.camera(camera), frame), ("rgb",), width)
            if not views or (views[0].weight > 0).sum() < LEAST_PIXELS:
                continue
            exact = truth_camera(known, exact_drive, camera, frame, width, 1).rgb
            np.savez_compressed(path, input=network_input(views[0]).astype(np.float16), exact=exact.astype(np.float16))
            print(path, flush=True)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="File of the weights, .npz."
)
@click.option("--steps", default=4000, show_default=True)
@click.option("--seed", default=0, show_default=True)
def train(folder: Path, out: Path, steps: int, seed: int) -> None:
    """Train the network on the pairs of a FOLDER."""
    torch.manual_seed(seed)
    random, network = np.random.default_rng(seed), FillNetwork()
    data = [(given, exact, np.argwhere(given[3].numpy() > 0.5)) for _, given, exact in read_pairs(folder)]
    shares = np.sqrt([len(some) for _, _, some in data])
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps, pct_start=0.1)
    begun_s, losses = time.monotonic(), []
    for step in range(1, steps + 1):
        crops = []
        for pick in random.choice(len(data), BATCH, p=shares / shares.sum()):
            given, exact, some = data[pick]
            corner = some[random.integers(len(some))] - random.integers(CROP, size=2)
            top, left = np.clip(corner, 0, np.array(exact.shape[1:]) - CROP)
            given, exact = (x[:, top : top + CROP, left : left + CROP].clone() for x in (given, exact))
            if random.random() < 0.5:
                given, exact = given.flip(-1), exact.flip(-1)
            gain = torch.from_numpy(np.exp(random.normal(0, EXPOSURE, (3, 1, 1)))).float()
            for red in RED:
                given[red : red + 3] *= gain
            crops.append((given, exact * gain))
        x, truth = (torch.stack(each) for each in zip(*crops, strict=True))
        image, weight = fixed(network, x), (x[:, 3:4] > 0.05).float()
        wrong = (image - truth) ** 2 * 10 + (image - truth).abs()
        loss = (
            (wrong.mean(1, keepdim=True) + 0.75 * distances(image, truth, box_mean)) * weight
        ).sum() / weight.sum().clamp_min(1)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
        if step % 500 == 0:
            print(f"{step} steps, {time.monotonic() - begun_s:.0f} s: {np.mean(losses[-500:]):.4f}", flush=True)
    write_weights(network, out)


def write_weights(network: FillNetwork, path: Path) -> None:
    """Write a network's weights for `learned_fixer.weights`."""
    values = {name: value.detach().numpy() for name, value in network.state_dict().items()}
    kernels = {name: value.transpose(2, 3, 1, 0) if value.ndim == 4 else value for name, value in values.items()}
    np.savez_compressed(path, **{name: value.astype(np.float16) for name, value in kernels.items()})


def read_weights(path: Path) -> FillNetwork:
    """Return the network whose weights `write_weights` wrote."""
    network = FillNetwork()
    with np.load(path) as file:
        values = {name: torch.from_numpy(file[name].astype(np.float32)) for name in file.files}
    network.load_state_dict({n: value.permute(3, 2, 0, 1) if value.ndim == 4 else value for n, value in values.items()})
    return network


@main.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
def test(folder: Path) -> None:
    """Print the error of never-seen pixels of the pairs of a FOLDER, filled and then fixed by `--fill learned`."""
    sums: dict[tuple[str, str], FloatArray] = {}
    for name, x, truth in read_pairs(folder):
        kind, never, given = "removed" if "removed" in name else "aside", x[3] > 0.5, x.permute(1, 2, 0).numpy()
        after = given[..., :3] + given[..., 3:4] * part_of(given) * added(given)
        for how, image in (("filled", x[:3]), ("fixed", torch.from_numpy(after).permute(2, 0, 1).clamp(0, 1))):
            squared = ((image - truth) ** 2).mean(0)[never]
            distance = distances(image[None], truth[None])[0, 0][never]
            of_view = np.array([len(squared), squared.sum().item(), distance.sum().item()])
            sums[kind, how] = sums.get((kind, how), np.zeros(3)) + of_view
    for (kind, how), (count, squares, total) in sorted(sums.items()):
        print(f"{kind}, {how}: {-10 * np.log10(squares / count):.2f} dB, {total / count:.3f}")


if __name__ == "__main__":
    main()
