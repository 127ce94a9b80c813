"""Fixers: functions that draw anew what no recorded image shows, in finished camera frames that are filled (`PlaneFill`).

A fixer is called with an `ImageToFix` and returns an image, of which only those pixels are used that show surfaces which no
recorded image confirms (`RecordedDepth.unseen`): all others keep their bits. The images that it is given besides are recorded
ones, so that a simulation, too, knows them all before. Another distribution registers a fixer in its pyproject.toml:

    [project.entry-points."unisim_blender.fixers"]
    name = "module:fixer"
"""

from __future__ import annotations

import hashlib
import inspect
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..errors import UnisimError, in_a_line
from ..geometry import BoolArray, FloatArray, bilinear, box_sums
from ..registry import Registry, named_function
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import FILLS, CameraFrame
from ..sensors.rays import Rays
from ..world.drive import Actor, Camera, CameraModel
from .confidence import DepthView, RecordedDepth
from .pending_image import Binding, PendingImage
from .tracer import Array, Maps

REFERENCES = 2
"""Number of recorded images that a fixer is given."""
MAX_READ_IMAGES = 8
"""Number of recorded images that stay in memory."""


@dataclass(frozen=True)
class ReferenceImage:
    """A recorded image: ``image`` (h, w, 3), sRGB in 0..1, exposed as the image to fix is; its camera and pose. ``warped``
    (H, W, 3): its colours at the pixels of the image to fix, where ``shown`` (H, W): it shows the same static surface."""

    image: Array
    model: CameraModel
    world_from_camera: FloatArray
    warped: Array
    shown: BoolArray


@dataclass(frozen=True)
class ImageToFix:
    """A rendered image (H, W, 3), sRGB in 0..1; its depth (H, W), metres along the ray, inf where nothing is hit; ``instance``
    (H, W), 0 for what is no actor; its confidence (H, W), 0..1; ``weight`` (H, W), 0..1, how much of the result is used, and
    ``filled`` (H, W), 0..1, how much of the image is filled ground or façade; the recorded images closest to it, the closest
    first; its camera and pose."""

    image: Array
    depth_m: Array
    instance: NDArray[np.int32]
    confidence: Array
    weight: Array
    filled: Array
    references: tuple[ReferenceImage, ...]
    model: CameraModel
    world_from_camera: FloatArray


class Fixer(Protocol):
    """A registered fixer. It has no state that changes: the same image is fixed alike, whatever came before."""

    name: str
    """One word: that of `unisim render --fill`."""

    def __call__(self, view: ImageToFix) -> Array:
        """Return the fixed image (H, W, 3), sRGB in 0..1."""


FIXERS: Registry[Fixer] = Registry("a fixer", "unisim_blender.fixers", ("name", "__call__"))
"""The registered fixers by the name that `unisim render --fill` has for them."""
register = FIXERS.register


def fixer_named(fill: str) -> Callable[[ImageToFix], Any] | None:
    """Return the fixer of a fill: a registered one, or ``module:function``; None for those of `FILLS`. Raises `UnisimError`."""
    if fill in FILLS:
        return None
    known = FIXERS if fill in FIXERS else FIXERS.with_plugins()
    if fill in known:
        return known[fill]
    return named_function("--fill", fill, "an ImageToFix", f"one of {', '.join((*FILLS, *known))}, or module:function")


def fixer_digest(fill: str) -> dict[str, str]:
    """Return the digest of the file that a fill's fixer is in, which frames depend on; nothing of a fill without one."""
    fixer = fixer_named(fill)
    if fixer is None:
        return {}
    file = inspect.getsourcefile(fixer if inspect.isroutine(fixer) else type(fixer))
    return {"fixer": hashlib.sha256(Path(file).read_bytes() if file else fill.encode()).hexdigest()}


class RecordedFixer:
    """The fixer of a fill, with the recorded images that it is given: those of ``cameras`` that a scene was trained on."""

    def __init__(self, fill: str, log: Log, cameras: Mapping[str, Camera]) -> None:
        self.fill, self.cameras, self._fixer = fill, cameras, fixer_named(fill)
        self._read = lru_cache(MAX_READ_IMAGES)(log.image)

    def fix(
        self,
        pending: PendingImage,
        bound: Binding,
        frame: CameraFrame,
        recorded: RecordedDepth,
        actors: Sequence[Actor | None],
        confidence: Callable[[Rays, Maps], Array],
    ) -> None:
        """Draw anew what no recorded image shows in the frame of a whole image, and mark it as unsupported. ``actors``: as of
        `RecordedDepth.unseen`; ``confidence`` gives that (N,) of rays by their maps. Raises `UnisimError`."""
        depth, instance, camera, time_s = frame.depth_m, frame.instance, pending.camera, pending.time_s
        assert depth is not None and instance is not None
        rays = camera_rays(camera, time_s, *pixel_grid(camera.model))
        flat = rays.flat()
        maps: Maps = {"depth": depth.reshape(-1), "instance": instance.reshape(-1)}
        unseen = recorded.unseen(flat, maps["depth"], maps["instance"], actors).reshape(depth.shape)
        if not unseen.any():
            return
        points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 0.0)[..., None]
        static = np.isfinite(depth) & (instance == 0)
        references = []
        for view in recorded.near(frame.world_from_camera, False).views[:REFERENCES]:
            image = self._image(view) / np.float32(255)
            gain = bound.gain(view.sensor_id, view.time_s)
            image = bound.exposed(image if gain is None else image / gain, camera.sensor_id, time_s)
            model = self.cameras[view.sensor_id].model_at(view.time_s)
            references.append(ReferenceImage(image, model, view.world_from_view, *_warped(image, view, points, static)))
        weight = np.where(unseen, box_sums(unseen, 1) / 9, 0).astype(np.float32)
        of_pixels = confidence(flat, maps).reshape(depth.shape)
        view_to_fix = ImageToFix(
            frame.rgb,
            depth.copy(),
            instance.copy(),
            of_pixels,
            weight,
            np.zeros(depth.shape, np.float32) if pending.filled is None else pending.filled,
            tuple(references),
            frame.model,
            frame.world_from_camera,
        )
        frame.rgb = self.fixed(view_to_fix)
        if frame.unsupported is not None:
            frame.unsupported = frame.unsupported | (weight > 0.5)

    def _image(self, view: DepthView) -> NDArray[np.uint8]:
        times = self.cameras[view.sensor_id].time_s
        return self._read(view.sensor_id, next(frame for frame, time_s in times.items() if time_s == view.time_s))

    def fixed(self, view: ImageToFix) -> Array:
        """Return the image, fixed by its weight. Raises `UnisimError`, which names the fixer, where that fails."""
        assert self._fixer is not None
        before, weight = view.image.copy(), view.weight.copy()
        try:
            image = np.asarray(self._fixer(view))
        except Exception as error:  # noqa: BLE001  another package's code may raise anything
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(last.filename).name}, line {last.lineno}"
            raise UnisimError(f'--fill "{self.fill}": {type(error).__name__}: {in_a_line(error)} ({place})') from error
        if image.shape != before.shape or image.dtype.kind not in "fiu":
            what = f"an array of shape {image.shape} and type {image.dtype}"
            raise UnisimError(f'--fill "{self.fill}": must return numbers of shape {before.shape}, not {what}')
        if not np.isfinite(image).all():
            raise UnisimError(f'--fill "{self.fill}": returns numbers that are not finite')
        after = before + weight[..., None] * (np.clip(image, 0, 1) - before)
        return np.where(weight[..., None] > 0, after, before).astype(np.float32)


def _warped(image: Array, view: DepthView, points: FloatArray, static: BoolArray) -> tuple[Array, BoolArray]:
    """Return the colours (H, W, 3) of a recorded image at points (H, W, 3), world frame, and whether it shows them (H, W), which
    are ``static`` (H, W)."""
    assert view.model is not None
    some = np.flatnonzero(static)
    some = some[view.shows(points.reshape(-1, 3)[some])[0]]
    u, v, _ = view.model.project(
        (points.reshape(-1, 3)[some] - view.world_from_view[:3, 3]) @ view.world_from_view[:3, :3]
    )
    warped, shown = np.zeros((static.size, 3), np.float32), np.zeros(static.size, bool)
    across, down = image.shape[1] / view.model.width, image.shape[0] / view.model.height
    warped[some], shown[some] = bilinear(image, u * across, v * down), True
    return warped.reshape(points.shape), shown.reshape(static.shape)
