"""Preparation of a log's surfels in the worker, while views show recorded and preliminary images; stopped and resumed."""

from __future__ import annotations

import queue
import time

import bpy
from bpy.app.handlers import persistent

from ..bridge.window import allowed, redraw, redraw_status_bar, run_soon
from ..editing.texts import Text, clock_text
from ..registering import Shortcut
from .client import Client, Request

POLL_S, REPORT_S = 0.25, 1.0
"""Intervals of looks at the worker's progress, and of its reports, seconds."""
MIN_SHARE = 0.02
"""Least share done from which the remaining time is estimated."""


class Preparation:
    """Progress of one log's surfels: at first of those near the shown frame, which views ask for, then of all."""

    def __init__(self) -> None:
        self.log = ""
        self.first: float | None = None
        """Share done of a first image's surfels, while a view waits for them."""
        self.share = 0.0
        """Share done of all surfels."""
        self.stopped = False
        self.problem = ""
        self.finished = 0
        """Number of preparations that were finished."""
        self._request: Request | None = None
        self._worker: Client | None = None
        self._since: tuple[float, float] | None = None

    @property
    def active(self) -> bool:
        """Whether something is prepared."""
        return self.first is not None or self._request is not None

    @property
    def text(self) -> str:
        """Progress in words."""
        share = int(100 * self.share)
        if self.problem:
            return self.problem
        if self.stopped:
            return Text("Preparation stopped at {share} %", share=share)
        if self.first is not None:
            return Text("Preparing a first image: {share} %", share=int(100 * self.first))
        if self._since is None or self.share - self._since[1] < MIN_SHARE:
            return Text("Preparing the finished image: {share} %", share=share)
        left = (1 - self.share) * (time.monotonic() - self._since[0]) / (self.share - self._since[1])
        return Text("Preparing the finished image: {share} %, {time} left", share=share, time=clock_text(left))

    @property
    def fraction(self) -> float:
        """Share done of what is prepared now."""
        return self.share if self.first is None or self.stopped else self.first

    def is_stopped(self, log: str) -> bool:
        """Return whether nothing of a log is to be prepared."""
        return self.stopped and log == self.log

    def follow(self, log: str, first: float | None) -> None:
        """Take the progress of a first image of a log; None where no view waits for one."""
        if log != self.log:
            self.end()
            self.log, self.share, self.problem = log, 0.0, ""
        self.first = first
        run_soon(watch, POLL_S)

    def begin(self, worker: Client) -> None:
        """Prepare all of the log's surfels, unless that is under way, stopped or failed."""
        if self._request is None and not self.stopped and not self.problem:
            self._worker, self._since = worker, None
            self._request = worker.ask("prepare", log=self.log)
            run_soon(watch, POLL_S)

    def end(self) -> None:
        """Cancel; the worker keeps what is done."""
        if self._request is not None and self._worker is not None:
            self._worker.cancel(self._request)
        self._request, self.first, self.stopped = None, None, False

    def gather(self) -> None:
        """Take in the worker's events."""
        while self._request is not None:
            try:
                event = self._request.events.get_nowait()
            except queue.Empty:
                return
            if event["event"] == "progress":
                self.share = event["share"]
                self._since = self._since or (time.monotonic(), self.share)
                continue
            self._request = None
            if event["event"] == "done":
                self.finished += 1
            self.problem = event.get("text", "")


PREPARATION = Preparation()
_reported: list[tuple[float, str]] = []
"""Time and text of the last report."""


def watch() -> float | None:
    """Take in progress, as a timer of Blender's, and show it; until nothing is prepared."""
    finished = PREPARATION.finished
    PREPARATION.gather()
    now, active = time.monotonic(), PREPARATION.active
    news = not _reported or (_reported[0][1] != PREPARATION.text and now - _reported[0][0] >= REPORT_S)
    if news or not active or PREPARATION.finished != finished:
        _reported[:] = [(now, PREPARATION.text)]
        redraw("VIEW_3D")
        redraw_status_bar()
    return POLL_S if active else None


class UNISIM_OT_stop_preparation(bpy.types.Operator):
    """Stop preparing images of this log; views show recorded images until it is resumed"""

    bl_label = "Stop Preparing Images"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something has to be prepared, and Esc is an animation's while it plays."""
        playing = getattr(context.screen, "is_animation_playing", False)
        return allowed(cls, (PREPARATION.active and not playing, "No images are being prepared"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        PREPARATION.end()
        PREPARATION.stopped = True
        run_soon(watch, POLL_S)
        return {"FINISHED"}


class UNISIM_OT_resume_preparation(bpy.types.Operator):
    """Go on preparing images of this log where that was stopped"""

    bl_label = "Resume Preparing Images"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        stopped = PREPARATION.stopped or bool(PREPARATION.problem)
        return allowed(cls, (stopped, "The preparation of images was not stopped"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        PREPARATION.stopped, PREPARATION.problem = False, ""
        run_soon(watch, POLL_S)
        return {"FINISHED"}


@persistent
def forget(*_: object) -> None:
    """Another file is open: its views ask for what they need."""
    PREPARATION.end()
    PREPARATION.log = ""


HANDLERS = (("load_post", forget),)
TIMERS = (watch,)
SHORTCUTS = (Shortcut("unisim.stop_preparation", "ESC", keymap="3D View", editor="VIEW_3D"),)
unregister = forget
