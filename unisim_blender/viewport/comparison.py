"""The recorded image in a view that the engine draws: beside the rendered one, instead of it, or the
difference of both."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from numpy.typing import NDArray

from ..core.world.drive import CameraModel
from ..editing.images.comparison import (
    PixelRectangle,
    RecordedImageRequest,
    RecordedImages,
    ShownImage,
    difference,
    errors,
    hatched,
    lacks_recorded,
    placement,
    tinted,
    visible,
)
from ..editing.images.views import marked_outside
from ..editing.sampled.scene import SampledObject
from ..editing.sampled.source import DriveSource
from ..editing.texts import Text
from .options import ViewOptions

FLICKER_S = 0.25
"""Duration of each image where they flicker: both, twice a second."""

IMAGES = RecordedImages()


class ViewComparison:
    """One view's recorded image, and how it is drawn with the rendered one."""

    def __init__(self) -> None:
        self.options = ViewOptions()
        self.lacks = ""
        """Why the view has no recorded image."""
        self.metrics = ""
        """Errors of the rendered image, as a sentence, where the difference is shown."""
        self.stands_in = False
        """Whether the recorded image stands in for the rendered one, which is being prepared."""
        self.turn = False
        """Whether the recorded image was drawn last, where images flicker."""
        self._request: RecordedImageRequest | None = None
        self._shown: ShownImage | None = None
        self._textures: dict[str, tuple[object, Any]] = {}
        """Textures by name, each after the key that says which image it is of."""
        self._metrics_key: object = None

    @property
    def mode(self) -> str:
        """The mode that is shown, of `MODES`: a view without a recorded image shows the rendered one."""
        return "RENDERED" if self.lacks else "RECORDED" if self.stands_in else self.options.mode

    @property
    def waits(self) -> bool:
        """Whether a recorded image is on its way."""
        return self.mode != "RENDERED" and self._request is not None and self._shown is None

    @property
    def arrived(self) -> bool:
        """Whether a recorded image has come that was not drawn yet."""
        return self.waits and self._request is not None and IMAGES.get(self._request) is not None

    @property
    def has_recorded(self) -> bool:
        """Whether the recorded image is there to be shown."""
        return self._shown is not None and not self.lacks

    @property
    def needs_render(self) -> bool:
        """Whether the rendered image is shown at all."""
        return bool(self.lacks) or self.options.mode != "RECORDED"

    @property
    def sentence(self) -> str:
        """Sentence that the view shows: why there is no recorded image, or how far it is from the rendered one."""
        if self.options.mode == "RENDERED":
            return ""
        return self.lacks or (self.metrics if self.mode == "DIFFERENCE" else "")

    def follow(
        self,
        options: ViewOptions,
        source: DriveSource,
        view: SampledObject,
        scenario: dict[str, Any],
        model: CameraModel,
        frame: float,
        untrained: bool,
    ) -> None:
        """Find the recorded image of what a view looks at: ``model`` is the view's camera model, at its size. An
        ``untrained`` drive may need it in place of the rendered one."""
        self.options, self.lacks, request = options, "", None
        if options.mode == "RENDERED" and not untrained:
            self._request = self._shown = None
            for name in ("recorded", "difference"):
                self._textures.pop(name, None)
            return
        self.lacks = lacks_recorded(view, scenario, source.drive, source.log, frame)
        if not self.lacks:
            lies = placement(source.drive.cameras[view.uid].model, model)
            if lies is None:
                self.lacks = Text("{camera} looks beside its recorded images", camera=view.name)
            elif source.log is not None:
                request = RecordedImageRequest(source.log, view.uid, int(frame), lies)
                if options.mode != "RENDERED":
                    there = IMAGES.get(request)
                    self.lacks = there.problem if there is not None else ""
                    fetch_next(request)
        if request is None or self._request is None or request.key != self._request.key:
            self._request, self._shown = request, None

    def gather(self) -> None:
        """Take in the recorded image, if it has come."""
        if self.mode != "RENDERED" and self._request is not None and self._shown is None:
            self._shown = IMAGES.get(self._request)
        if self._shown is not None and self._shown.problem:
            self.lacks = self._shown.problem

    def draw(
        self,
        rectangle: PixelRectangle,
        region: tuple[int, int],
        rendered: NDArray[np.float32],
        srgb: NDArray[np.uint8],
        unsupported: NDArray[np.bool_] | None,
        confidence: NDArray[np.float32] | None,
        stamp: object,
        finished: bool,
        stale: bool,
        outside: bool = False,
    ) -> None:
        """Draw what the options ask for into ``rectangle`` of a region of that size (width, height).

        ``rendered`` (H, W, 4) is linear, ``srgb`` (H, W, 3) the same in eight bits, both with their lowest row first;
        ``stamp`` is another one whenever these are. ``finished``: whether no more of the rendered image is to come;
        ``stale``: whether nothing has come of it. A stale image stands beside the recorded one that it was rendered
        for, and not beside the next. ``outside``: whether it is of a frame outside the drive.
        """
        mode, size = self.mode, (rectangle[3], rectangle[2])
        shown = self._shown if self._shown is not None and self._shown.linear.shape[:2] == size else None
        self.turn = int(time.monotonic() / FLICKER_S) % 2 == 0
        split = {"RENDERED": 0.0, "RECORDED": 1.0, "SPLIT": self.options.split}.get(mode, float(self.turn))
        there = rendered.size > 0 and rendered.shape[:2] == size
        if mode == "DIFFERENCE":
            if shown is None or not there:
                return
            key = stamp, shown, self.options.gain
            image = partial(difference, shown.srgb, shown.covered, srgb, self.options.gain)
            draw_part(self._texture("difference", key, image, stale), rectangle, 0.0, 1.0)
            if self._metrics_key != (*key, rectangle, region, finished):
                self.metrics = self._metrics_text(shown, srgb, visible(rectangle, region)) if finished else ""
                self._metrics_key = (*key, rectangle, region, finished)
            return
        recorded = self._textures["recorded"][1] if stale and "recorded" in self._textures else None
        if shown is not None:
            recorded = self._texture("recorded", shown, lambda: shown.linear, stale)
        if recorded is not None and split > 0.0:
            draw_part(recorded, rectangle, 0.0, split)
        if there and split < 1.0:
            over = unsupported if self.options.unsupported else None
            colours = confidence if self.options.confidence else None

            def marked() -> NDArray[np.float32]:
                image = marked_outside(rendered) if outside else rendered
                image = image if colours is None else tinted(image, colours)
                return image if over is None else hatched(image, over)

            texture = self._texture("rendered", (stamp, over is not None, colours is not None, outside), marked)
            draw_part(texture, rectangle, split, 1.0)

    def _metrics_text(self, shown: ShownImage, srgb: NDArray[np.uint8], seen: tuple[slice, slice]) -> str:
        metrics = errors(shown.srgb[seen], shown.covered[seen], srgb[seen])
        if metrics is None:
            return ""
        return Text(
            "{difference}: mean absolute error {error:.1f} of 255, PSNR {psnr:.1f} dB",
            difference=difference_of(self.options.gain), error=float(metrics[0]), psnr=float(metrics[1]),
        )  # fmt: skip

    def _texture(self, name: str, key: object, make: Callable[[], NDArray[np.float32]], stale: bool = False) -> Any:
        """Return an image (H, W, 4) as a texture, made where there is none, or one of another key, unless ``stale``."""
        if name not in self._textures or (self._textures[name][0] != key and not stale):
            image = make()
            buffer = gpu.types.Buffer("FLOAT", image.size, np.ascontiguousarray(image).ravel())
            texture = gpu.types.GPUTexture((image.shape[1], image.shape[0]), format="RGBA16F", data=buffer)
            self._textures[name] = key, texture
        return self._textures[name][1]


def difference_of(gain: float) -> str:
    """Return what a difference is called in a view."""
    return Text("|recorded - rendered| x{gain:g}", gain=gain)


def fetch_next(request: RecordedImageRequest) -> None:
    """Have the next frame's recorded image ready, too."""
    later = request.frame + 1
    if later in request.log.image_frames(request.camera):
        IMAGES.fetch(RecordedImageRequest(request.log, request.camera, later, request.placement))


def draw_part(texture: Any, rectangle: PixelRectangle, begin: float, end: float) -> None:
    """Draw a texture into ``rectangle``, of its width the part from ``begin`` to ``end``; both end between pixels."""
    left, bottom, width, height = rectangle
    first, last = round(begin * width), round(end * width)
    if last <= first:
        return
    u0, u1 = first / width, last / width
    corners = {
        "pos": (
            (left + first, bottom),
            (left + last, bottom),
            (left + first, bottom + height),
            (left + last, bottom + height),
        ),
        "texCoord": ((u0, 0.0), (u1, 0.0), (u0, 1.0), (u1, 1.0)),
    }
    shader = gpu.shader.from_builtin("IMAGE")
    batch = batch_for_shader(shader, "TRI_STRIP", corners)
    shader.bind()
    shader.uniform_sampler("image", texture)
    batch.draw(shader)
