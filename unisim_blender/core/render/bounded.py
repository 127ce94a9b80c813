"""Rendering of frames within an error bound, at the cheapest settings that keep it, estimated on a sample of rays.

A beam's error depends on that beam alone. So a sample of a sweep's beams, rendered at each of the settings and at the
truth, gives an upper bound on a quantile of all errors, whatever their distribution.

This does not hold for an image's squared errors: one pixel in two thousand can have half of their sum, and no sample of
a frame has enough such pixels. Settings are therefore chosen once for each camera, by pixels of frames spread over the
drive. Each image is then checked by a sample of its own pixels, denser at edges; the worst pixels' contribution is
taken from the drive. A frame's settings depend on the drive and the frame alone, not on what was rendered before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..colour import lab_from_srgb
from ..geometry import FloatArray
from ..sensors.camera import pixel_grid
from ..sensors.error_bound import (
    BoundCheck,
    ErrorBound,
    ErrorBoundResult,
    depth_errors,
    drawn,
    mean_at_most,
    quantile_check,
    sample_frames,
)
from ..sensors.frames import CameraFrame, LidarFrame
from ..sensors.lidar import lidar_rays
from ..sensors.rays import Rays
from ..world.captures import Capture
from ..world.drive import Lidar
from .captures import CaptureStates, render_image, render_sweep
from .lattice import Region
from .quality import ERROR_BOUND_QUALITIES, TRUTH_QUALITY, Quality
from .renderer import Renderer
from .tracer import tiled

SWEEP_SAMPLE_BEAMS = 512
"""Number of beams of a sweep that are compared with the truth."""
DRIVE_SAMPLE_PIXELS = 1024
"""Number of pixels of each of `sample_frames` from which a camera's settings are chosen."""
IMAGE_SAMPLE_PIXELS = 900
"""Number of pixels of each image that are compared with the truth."""
PATCH_PX, DRIVE_SAMPLE_PATCHES, IMAGE_SAMPLE_PATCHES = 16, 2, 16
"""Edge in pixels of the squares sampled where pixels depend on their neighbours, and their number in each frame and
image."""
WORST_PIXEL_SHARE = 0.02
"""Share of a drive's pixels, those of the largest errors, that is too rare to be judged by one image's sample."""
WORST_ERROR_FACTOR = 1.5
"""Factor from the worst pixels' contribution to the drive's mean error to that of a single image."""
DRIVE_STANDARD_ERRORS, IMAGE_STANDARD_ERRORS = 1.0, 2.5
"""Number of standard errors added to a mean over the drive's pixels, and over an image's."""
START_MARGIN_FACTOR = 1.5
"""Factor on the drive's errors at which the settings that are tried first keep the bound: a second image costs more."""

Colours = NDArray[np.float64]


class BoundedRenderer:
    """Renders captures of a drive within ``bounds``; sensors without a bound at the renderer's own quality. ``draw`` as
    of `captures.render_sweep`; ``seed`` is of the samples."""

    def __init__(
        self,
        renderer: Renderer,
        states: CaptureStates,
        bounds: Sequence[ErrorBound],
        draw: int | None = None,
        seed: int = 0,
    ) -> None:
        self.renderer, self.states, self.draw, self.seed = renderer, states, draw, seed
        self.of_depth = tuple(bound for bound in bounds if bound.unit == "mm")
        self.of_colour = tuple(bound for bound in bounds if bound.unit != "mm")
        self._drives: dict[tuple[str, int | None, bool], _DrivePixels] = {}

    def render(
        self, capture: Capture, passes: Sequence[str] = ("rgb",), width: int | None = None
    ) -> CameraFrame | LidarFrame:
        """Render a capture; see `image` and `sweep`."""
        if capture.sensor_id in self.states.drive.cameras:
            return self.image(capture, passes, width)
        return self.sweep(capture)

    def sweep(self, capture: Capture) -> LidarFrame:
        """Render a sweep. Settings are tried on the sample alone, the cheapest first."""
        if not self.of_depth:
            return render_sweep(self.renderer, self.states, capture, self.draw)
        lidar = self.states.lidar(capture.sensor_id)
        rays = lidar_rays(lidar, capture.time_s(lidar)).flat()
        rng = np.random.default_rng(capture.seed(self.seed))
        some = drawn(np.ones(len(rays.time_s)), SWEEP_SAMPLE_BEAMS, rng)
        sample = rays.part(some)
        truth = self._depths(sample, lidar, TRUTH_QUALITY)
        for name, quality in ERROR_BOUND_QUALITIES.items():
            errors = depth_errors(self._depths(sample, lidar, quality), truth)
            error_bound = ErrorBoundResult(
                name, SWEEP_SAMPLE_BEAMS, tuple(quantile_check(bound, errors) for bound in self.of_depth)
            )
            if error_bound.holds:
                break
        with at_quality(self.renderer, quality):
            sweep = render_sweep(self.renderer, self.states, capture, self.draw)
        sweep.error_bound = error_bound
        return sweep

    def _depths(self, rays: Rays, lidar: Lidar, quality: Quality) -> NDArray[np.float32]:
        """Return depths (N,) of rays at a quality."""
        times = rays.time_s[np.isfinite(rays.time_s)]
        window = (float(times.min()), float(times.max())) if times.size else (0.0, 0.0)
        with at_quality(self.renderer, quality):
            return self.renderer.beams(self.states.states.state(*window), rays, lidar)[0]

    def image(self, capture: Capture, passes: Sequence[str] = ("rgb",), width: int | None = None) -> CameraFrame:
        """Render an image with these passes. Bounds are of its colours."""
        renderer, states = self.renderer, self.states
        if not self.of_colour:
            return render_image(renderer, states, capture, passes, width)
        camera_id = capture.sensor_id
        camera = states.camera(camera_id, width)
        # between frames there may be what no frame shows
        state = states.state(camera, capture.time_s(camera))
        in_patches = capture.frame is None and not renderer.alone(state, camera)
        if (camera_id, width, in_patches) not in self._drives:
            patches = Patches(renderer, states, camera_id, width, in_patches)
            self._drives[camera_id, width, in_patches] = _DrivePixels(patches, self.seed)
        drive = self._drives[camera_id, width, in_patches]
        patches, sample = drive.patches, None
        scale = START_MARGIN_FACTOR
        names = list(ERROR_BOUND_QUALITIES)
        while True:
            # what an image showed of its own errors moves what is expected of those to come
            name = next((n for n in names if drive.keeps(n, self.of_colour, scale)), names[-1])
            with at_quality(renderer, ERROR_BOUND_QUALITIES[name]):
                image = render_image(renderer, states, capture, passes, width)
            if sample is None:
                rng = np.random.default_rng(capture.seed(self.seed))
                sample = _Checked(patches, capture, image.rgb, rng)
            checks = tuple(sample.check(bound, image.rgb, drive.errors(name)) for bound in self.of_colour)
            image.error_bound = ErrorBoundResult(name, len(sample.units), checks)
            names = names[names.index(name) + 1 :]
            if image.error_bound.holds or not names:
                return image
            scale = max(1.0, max(check.most / max(drive.errors(name).at_most(check.bound), 1e-20) for check in checks))


@contextmanager
def at_quality(renderer: Renderer, quality: Quality) -> Iterator[None]:
    """Set a renderer's quality inside the context."""
    before = renderer.quality
    renderer.quality = quality
    try:
        yield
    finally:
        renderer.quality = before


def colour_errors(rgb: Colours, truth: Colours) -> dict[str, FloatArray]:
    """Return errors (N,) of colours (N, 3), sRGB in 0..1, by `ErrorBound.unit`: mean squares over the channels, and CIE
    1976 colour differences."""
    assert rgb.shape == truth.shape, (rgb.shape, truth.shape)
    lab = [lab_from_srgb(np.asarray(x, np.float32)) for x in (rgb, truth)]
    return {"dB": ((rgb - truth) ** 2).mean(-1), "dE": np.linalg.norm(lab[0] - lab[1], axis=-1)}


@dataclass(frozen=True)
class _Errors:
    """Errors of a drive's pixels at one of the settings, by `ErrorBound.unit`."""

    of_pixels: dict[str, FloatArray]

    def at_most(self, bound: ErrorBound) -> float:
        return mean_at_most(self.of_pixels[bound.unit], DRIVE_STANDARD_ERRORS)

    def cap(self, bound: ErrorBound) -> float:
        """Return the error that `WORST_PIXEL_SHARE` of the pixels exceed."""
        return float(np.quantile(self.of_pixels[bound.unit], 1 - WORST_PIXEL_SHARE))

    def beyond(self, bound: ErrorBound) -> float:
        """Return an upper bound on the contribution of the errors' excess over the cap to their mean."""
        return mean_at_most(np.maximum(self.of_pixels[bound.unit] - self.cap(bound), 0), DRIVE_STANDARD_ERRORS)


class Patches:
    """Division of a camera's images into squares of ``side`` pixels: of 1 where each pixel depends on its own ray alone
    and ``in_patches`` is false, else of `PATCH_PX`."""

    def __init__(
        self, renderer: Renderer, states: CaptureStates, camera_id: str, width: int | None, in_patches: bool = False
    ) -> None:
        self.renderer, self.states, self.width = renderer, states, width
        self.camera = states.camera(camera_id, width)
        of_frames = (states.state(self.camera, time_s) for time_s in self.camera.time_s.values())
        alone = not in_patches and all(renderer.alone(state, self.camera) for state in of_frames)
        self.side = 1 if alone else PATCH_PX
        w, h = self.camera.model.width, self.camera.model.height
        self.pixels = h * w
        self.rows, self.columns = -(-h // self.side), -(-w // self.side)

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """Numbers (P,) of all patches, neighbours next to each other."""
        return tiled((self.rows, self.columns))

    def region(self, unit: int) -> Region:
        """Return the region of the patch of this number."""
        y, x = (int(a) * self.side for a in divmod(unit, self.columns))
        model = self.camera.model
        return Region(x, y, min(model.width, x + self.side), min(model.height, y + self.side))

    def owners(self, units: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return for each pixel of the patches ``units`` (U,) the index of its patch in ``units``: (N,)."""
        areas = [(r.right - r.left) * (r.bottom - r.top) for r in map(self.region, units)] if self.side > 1 else 1
        return np.repeat(np.arange(len(units)), areas)

    def shown(self, image: NDArray[np.float32], units: NDArray[np.int64]) -> Colours:
        """Return the colours (N, 3) of an image (h, w, 3) in the patches ``units`` (U,), sRGB in 0..1."""
        if self.side == 1:
            return np.clip(image.reshape(-1, 3)[units], 0, 1).astype(np.float64)
        parts = [image[r.top : r.bottom, r.left : r.right].reshape(-1, 3) for r in map(self.region, units)]
        return np.clip(np.concatenate(parts), 0, 1).astype(np.float64)

    def rendered(self, capture: Capture, units: NDArray[np.int64], quality: Quality) -> Colours:
        """Return the colours (N, 3) of the patches ``units`` (U,), sRGB in 0..1, rendered with a ray for every
        pixel."""
        renderer, states, camera = self.renderer, self.states, self.camera
        with at_quality(renderer, replace(quality, lattice=1)):
            if self.side == 1:
                u, v = (x.reshape(-1)[units] for x in pixel_grid(camera.model))
                time_s = capture.time_s(camera)
                colours = renderer.pixels(states.state(camera, time_s), camera, time_s, u, v)
                return np.clip(colours, 0, 1).astype(np.float64)
            parts = [
                render_image(renderer, states, capture, width=self.width, region=region).rgb.reshape(-1, 3)
                for region in map(self.region, units)
            ]
        return np.clip(np.concatenate(parts), 0, 1).astype(np.float64)


class _DrivePixels:
    """Patches of frames spread over a drive, and their errors at the settings that were asked for."""

    def __init__(self, patches: Patches, seed: int) -> None:
        self.patches = patches
        frames = sample_frames(patches.camera.time_s)
        count = DRIVE_SAMPLE_PIXELS if patches.side == 1 else DRIVE_SAMPLE_PATCHES
        rng = np.random.default_rng([seed, *patches.camera.sensor_id.encode()])
        captures = (Capture.of_frame(patches.camera, frame) for frame in frames)
        self._units = {capture: patches.order[drawn(np.ones(len(patches.order)), count, rng)] for capture in captures}
        self._truth = self._rendered(TRUTH_QUALITY)
        self._errors: dict[str, _Errors] = {}

    def _rendered(self, quality: Quality) -> Colours:
        return np.concatenate(
            [self.patches.rendered(capture, units, quality) for capture, units in self._units.items()]
        )

    def errors(self, name: str) -> _Errors:
        """Return the errors at the settings of this name."""
        if name not in self._errors:
            self._errors[name] = _Errors(colour_errors(self._rendered(ERROR_BOUND_QUALITIES[name]), self._truth))
        return self._errors[name]

    def keeps(self, name: str, bounds: Sequence[ErrorBound], scale: float) -> bool:
        """Return whether settings are expected to keep the bounds in an image whose errors are ``scale`` times the
        drive's."""
        return all(scale * self.errors(name).at_most(bound) <= bound.most for bound in bounds)


class _Checked:
    """Sampled patches of an image and their truth. Patches with edges are drawn more often: most errors are there."""

    def __init__(
        self, patches: Patches, capture: Capture, image: NDArray[np.float32], rng: np.random.Generator
    ) -> None:
        self.patches = patches
        weights = edges(image)
        weights += 0.5 * weights.mean() + 1e-6
        side = patches.side
        weights = np.add.reduceat(
            np.add.reduceat(weights, np.arange(0, len(weights), side), 0), np.arange(0, weights.shape[1], side), 1
        )
        weights = weights.reshape(-1)[patches.order]
        chosen = drawn(weights, IMAGE_SAMPLE_PIXELS if side == 1 else IMAGE_SAMPLE_PATCHES, rng)
        self.units = patches.order[chosen]
        self._owners = patches.owners(self.units)
        self._scale = weights.sum() / (weights[chosen] * patches.pixels)
        self._truth = patches.rendered(capture, self.units, TRUTH_QUALITY)

    def _terms(self, of_pixels: FloatArray) -> FloatArray:
        """Return each patch's estimate of the image's mean (Hansen & Hurwitz 1943)."""
        return np.bincount(self._owners, of_pixels, len(self.units)) * self._scale

    def check(self, bound: ErrorBound, image: NDArray[np.float32], drive: _Errors) -> BoundCheck:
        """Check a bound in an image of the same frame, given the drive's errors at the same settings."""
        errors = colour_errors(self.patches.shown(image, self.units), self._truth)[bound.unit]
        terms, capped = self._terms(errors), self._terms(np.minimum(errors, drive.cap(bound)))
        most = max(
            mean_at_most(terms, IMAGE_STANDARD_ERRORS),
            mean_at_most(capped, IMAGE_STANDARD_ERRORS) + WORST_ERROR_FACTOR * drive.beyond(bound),
        )
        return BoundCheck(bound, float(terms.mean()), most)


def edges(image: NDArray[np.float32]) -> FloatArray:
    """Return the largest difference (h, w) of each pixel's colour from its four neighbours', over the channels of an
    image (h, w, 3)."""
    out = np.zeros(image.shape[:2])
    for a, b, axis in ((out[1:], out[:-1], 0), (out[:, 1:], out[:, :-1], 1)):
        step = np.abs(np.diff(image, axis=axis)).max(-1)
        np.maximum(a, step, out=a)
        np.maximum(b, step, out=b)
    return out
