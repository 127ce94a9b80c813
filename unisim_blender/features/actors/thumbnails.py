"""Thumbnails of actors as icons, and the words for their colours, made by a process beside Blender.

The process reads the log's images once and keeps what it makes in the user's cache folder. Where no recorded image
shows an actor that a trained scene has, the worker renders it. Until a thumbnail is there, a grey one
stands in its place.
"""

from __future__ import annotations

import queue
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...bridge.changes import following
from ...bridge.objects.imported import apply_words, source_of
from ...bridge.window import redraw, run_soon
from ...core.actor_images.cache import ActorImage, cached_images
from ...core.actor_images.names import plain_names
from ...core.errors import UnisimError
from ...core.model.scene_file import read_scene_header
from ...core.world.drive import Actor
from ...editing.actors.portraits import Portrait, portrait_request, save_portrait, saved_portrait
from ...editing.actors.table import named_actors
from ...editing.sampled.source import DriveSource
from ...preferences import device, interpreter
from ...process.client import client
from ...process.tasks import Task
from ..actor_list import listing

LOOK_S = 0.2
"""Between two looks whether something has come."""
GREY = 0.22
EDGE_PX = 32


class ThumbnailMaker(Task):
    """A process that makes the thumbnails of one log. ``lines`` come in as it writes them; ``ended`` is set at its end."""

    hears, entry, niceness = True, "actors", 10

    def __init__(self, log_path: Path, chosen: str) -> None:
        super().__init__([str(log_path)], log_path, 0.0, chosen)
        self.lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

    @property
    def done(self) -> float:
        return 0.0

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return not self.running

    def hear(self, event: dict[str, Any]) -> None:
        self.lines.put(event)

    def stop(self) -> None:
        """End the process."""
        self.cancelled = True
        if self.process is not None and self.process.poll() is None:
            self.process.kill()


_known: dict[Path, dict[str, ActorImage]] = {}
"""Images of the actors of each log, by id, as far as they are known."""
_complete: dict[Path, dict[str, str]] = {}
"""The words for the colours of the actors of logs whose images have all been looked at, by id."""
_makers: dict[Path, ThumbnailMaker] = {}
_problems: dict[Path, str] = {}
"""Why a log's thumbnails could not be made; it is not tried again before another file is opened."""
_plain: dict[Path, dict[str, str]] = {}
"""Names without words, by log and id."""
_wanted: deque[tuple[Path, str]] = deque()
"""Actors of trained scenes, by folder and id, that the worker is to render; the newest first."""
_portraits: dict[tuple[Path, str], Path | None] = {}
"""Rendered thumbnails by folder and id; None for an actor that cannot be rendered, or is not yet."""
_rendering: list[Portrait] = []
_icons: list[Any] = []
"""Blender's collection of previews, where there is one."""


def ask(log_path: Path) -> None:
    """Have a log's thumbnails and words made, unless they are kept, under way, or failed before."""
    if log_path in _complete or log_path in _makers or log_path in _problems:
        return
    cached = cached_images(log_path)
    if cached is not None:
        _known[log_path] = cached
        _complete[log_path] = {uid: image.word for uid, image in cached.items()}
    elif not log_path.exists():
        _problems[log_path] = "the log is not at hand"
    elif not bpy.app.background:
        _makers[log_path] = maker = ThumbnailMaker(log_path, interpreter())
        maker.start()
        _look_soon()


def images_of(log_path: Path) -> dict[str, ActorImage]:
    """Return what is known of a log's actors by id."""
    return _known.get(log_path, {})


def icon_of(log_path: Path, uid: str, scene_path: Path | None = None) -> int:
    """Return the icon of an actor: recorded, else rendered from the trained scene in a folder, else grey. Reads nothing
    from disk itself and works nothing out, so that drawing may call it."""
    recorded = _known.get(log_path, {}).get(uid)
    if recorded is not None and recorded.image is not None:
        return _loaded(recorded.image)
    if scene_path is None or (recorded is None and log_path in _makers):
        return grey()
    key = scene_path, uid
    if key not in _portraits:
        _portraits[key] = None
        _wanted.appendleft(key)
        _look_soon()
    rendered = _portraits[key]
    return grey() if rendered is None else _loaded(rendered)


def grey() -> int:
    """Return the icon that stands where no thumbnail is yet."""
    icons = _collection()
    if "grey" not in icons:
        preview = icons.new("grey")
        pixels = np.full((EDGE_PX, EDGE_PX, 4), GREY, np.float32)
        pixels[..., 3] = 1.0
        preview.image_size = EDGE_PX, EDGE_PX
        preview.image_pixels_float.foreach_set(pixels.ravel())
    return icons["grey"].icon_id


def _loaded(path: Path) -> int:
    """The icon of a file, which Blender reads when it first draws it."""
    icons = _collection()
    name = str(path)
    if name not in icons:
        icons.load(name, name, "IMAGE")
    return icons[name].icon_id


def _collection() -> Any:
    if not _icons:
        from bpy.utils import previews

        _icons.append(previews.new())
    return _icons[0]


def _look_soon() -> None:
    run_soon(_look, LOOK_S, persistent=True)


def _look() -> float | None:
    """Take in what has come."""
    news = False
    for log_path, maker in list(_makers.items()):
        ended = maker.ended  # before the last lines are taken, else one could be left
        while not maker.lines.empty():
            said = maker.lines.get()
            image = Path(said["image"]) if said.get("image") else None
            actor = ActorImage(str(said.get("uid", "")), str(said.get("word", "")), image)
            _known.setdefault(log_path, {})[actor.uid] = actor
            news = True
        if ended:
            del _makers[log_path]
            news = True
            if maker.code == 0:
                _complete[log_path] = {uid: actor.word for uid, actor in _known.get(log_path, {}).items()}
            else:
                _problems[log_path] = (list(maker.words) or ["it was stopped"])[-1]
    news |= _render()
    if news:
        name_actors()
        redraw("VIEW_3D", "PROPERTIES")
    return LOOK_S if _makers or _rendering or _wanted else None


def _render() -> bool:
    """Have the next actor rendered, where none is; return whether one has come."""
    news = False
    if _rendering:
        portrait = _rendering[0]
        portrait.take(client(interpreter()))
        if not portrait.ended:
            return False
        _rendering.clear()
        if portrait.pixels is not None:
            with suppress(UnisimError, OSError):
                _portraits[portrait.scene_path, portrait.uid] = save_portrait(
                    portrait.scene_path, portrait.uid, portrait.pixels
                )
        news = True
    while _wanted and not _rendering:
        scene_path, uid = _wanted.popleft()
        saved = saved_portrait(scene_path, uid)
        if saved is not None:
            _portraits[scene_path, uid], news = saved, True
            continue
        with suppress(UnisimError, OSError):
            header = read_scene_header(scene_path)
            actor = header.drive.actors.get(uid)
            source = DriveSource(
                (scene_path / header.log_path).resolve(), scene_path, header.drive, None, header.parked
            )
            asked = asked_portrait(source, actor) if actor is not None else None
            if asked is not None:
                _rendering.append(asked)
    return news


def asked_portrait(source: DriveSource, actor: Actor) -> Portrait | None:
    """Ask the worker for the portrait of an actor of a trained scene; None where no camera came near it."""
    assert source.scene_path is not None
    asked = portrait_request(source, actor, source.scene_path.name)
    if asked is None:
        return None
    request = client(interpreter()).ask(
        "camera", **asked.values, passes=["rgb", "instance"], quality="balanced", device=device()
    )
    return Portrait(source.scene_path, actor.uid, request)


def name_actors() -> None:
    """Add the words for their colours to the actors' names in all scenes of the file."""
    if bpy.app.is_job_running("RENDER") or following.dragging():
        return  # the next look at the table does it
    for scene in bpy.data.scenes:
        if scene.unisim.log:
            name_in(scene)


def name_in(scene: bpy.types.Scene) -> None:
    """Add the words to the actors' names in one scene, where these are known."""
    log_path = log_of(scene)
    words = _complete.get(log_path)
    if not words:
        return
    try:
        plain = _plain.setdefault(log_path, plain_names(named_actors(source_of(scene))))
    except (UnisimError, OSError):
        return
    renamed = apply_words(scene, plain, words)
    if not renamed:
        return
    following.renamed(scene, renamed)
    listing.refresh_soon(scene)
    for warning in scene.unisim_check.warnings:
        warning.name = renamed.get(warning.name, warning.name)


def log_of(scene: bpy.types.Scene) -> Path:
    """Return the folder of a scene's log."""
    return Path(bpy.path.abspath(scene.unisim.log))


def scene_of(scene: bpy.types.Scene) -> Path | None:
    """Return the folder of a scene's trained scene; None where it has none."""
    return Path(bpy.path.abspath(scene.unisim.scene)) if scene.unisim.scene else None


def follow(scene: bpy.types.Scene) -> None:
    """A scene's table was brought up to date: after an import, undo, another file, and at each frame."""
    log_path = log_of(scene)
    ask(log_path)
    if log_path in _complete and not bpy.app.is_job_running("RENDER") and not following.dragging():
        names = {entry.name.partition(".")[0] for entry in listing.table_of(scene).entries.values()}
        if log_path not in _plain or any(
            _complete[log_path].get(uid) and name in names for uid, name in _plain[log_path].items()
        ):
            name_in(scene)


@bpy.app.handlers.persistent
def try_again(*_: object) -> None:
    """Another file: what failed is tried once more."""
    _problems.clear()


HANDLERS = (("load_pre", try_again),)
TIMERS = (_look,)


def register() -> None:
    """Begin to follow."""
    listing.after.append(follow)


def unregister() -> None:
    """End all processes and throw the icons away."""
    listing.after.remove(follow)
    for maker in _makers.values():
        maker.stop()
    for cache in (_makers, _known, _complete, _problems, _plain, _wanted, _portraits, _rendering):
        cache.clear()
    if _icons:
        from bpy.utils import previews

        previews.remove(_icons.pop())
