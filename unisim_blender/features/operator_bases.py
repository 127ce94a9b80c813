"""Bases of operators: those that need something, that report errors, and that work in steps, with the window drawn in
between, so that the window never waits for a whole drive."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, ClassVar, TypeVar

import bpy
from bpy.props import FloatProperty

from ..bridge.window import Need, allowed, refresh
from ..core.errors import UnisimError
from ..editing.texts import Text
from ..process.background import running, what_runs
from .problems import fail

BUSY_S = 0.05
"""Time for which an operator works before the window is drawn, in seconds."""
JOIN_S = 0.002
"""Time for which the end of a thread is waited for at once, in seconds."""
T = TypeVar("T")


def reporting(execute: Callable[[Any, bpy.types.Context], set[str]]) -> Callable[[Any, bpy.types.Context], set[str]]:
    """Decorate an operator's `execute`: a `UnisimError` or an `OSError` is reported, and the operator is cancelled."""

    @functools.wraps(execute)
    def reported(self: Any, context: bpy.types.Context) -> set[str]:
        try:
            return execute(self, context)
        except (UnisimError, OSError) as fault:
            return fail(self, fault)

    return reported


def _in_unit(unit: str) -> Callable[..., Any]:
    """Return what makes a number of an operator in a unit of Blender's. ``once``: it is the default again at the next
    call."""

    def number(name: str, description: str, default: float = 0.0, once: bool = True, **limits: Any) -> Any:
        options = {"SKIP_SAVE"} if once else {"ANIMATABLE"}
        return FloatProperty(name=name, description=description, default=default, unit=unit, options=options, **limits)

    return number


in_metres, in_seconds, in_m_s, in_m_s2 = map(_in_unit, ("LENGTH", "TIME_ABSOLUTE", "VELOCITY", "ACCELERATION"))


def draw_split(operator: Any, *names: str) -> None:
    """Draw settings of an operator, their names on the left."""
    layout = operator.layout
    layout.use_property_split, layout.use_property_decorate = True, False
    for name in names:
        layout.prop(operator, name)


class Needing:
    """Base of operators that need something: where one of ``needs`` is not met, the button is grey and its tooltip says
    why."""

    needs: ClassVar[tuple[Callable[[bpy.types.Context], Need], ...]]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether all needs are met."""
        return all(allowed(cls, need(context)) for need in cls.needs)


class Editing(Needing):
    """Base of operators that change the file, each one undo step."""

    bl_options = {"REGISTER", "UNDO"}


class EditsObjects(Editing):
    """Base of those that change objects of the drive. Errors are reported."""

    def edit(self: Any, context: bpy.types.Context) -> list[bpy.types.Object] | set[str] | None:
        """Edit it. Return the objects that are to be evaluated again, or the operator's result where that is another one
        than FINISHED. Raises `UnisimError`."""
        raise NotImplementedError

    @reporting
    def execute(self: Any, context: bpy.types.Context) -> set[str]:
        changed = self.edit(context)
        if isinstance(changed, set):
            return changed
        if changed is not None:
            refresh(changed)
        return {"FINISHED"}


def nothing_runs(context: bpy.types.Context) -> Need:
    """Nothing runs in the background."""
    return not running, Text("{what}: cancel it or wait until it ends", what=what_runs() or "")


class InSteps:
    """Base of operators that work in steps: `execute` does all at once, for scripts and without a window; `in_steps` does a step
    at each tick of a timer. While it works, the window hears Esc and nothing else, so the scene stays as it
    was at the press."""

    timer: Any = None
    """Set while it works in steps."""
    blocks: ClassVar[bool] = True
    """Whether the window hears nothing but Esc meanwhile."""

    def work(self, context: bpy.types.Context) -> Iterator[str | None]:
        """Yield after each step what the status bar says; None where nothing can be done but wait.
        Raises `UnisimError`."""
        raise NotImplementedError

    def stopped(self, context: bpy.types.Context, fault: bool) -> None:
        """Called after a fault, and after Esc."""

    def finished(self, context: bpy.types.Context) -> None:
        """Called at the end of work that was done in steps."""

    @reporting
    def execute(self: Any, context: bpy.types.Context) -> set[str]:
        """Do all at once; what a file browser asked for is done in steps."""
        if getattr(self, "by_hand", False):
            return self.in_steps(context)
        for _ in self.work(context):
            pass
        return {"FINISHED"}

    def ask_for_path(self: Any, context: bpy.types.Context, event: bpy.types.Event | None = None) -> set[str]:
        """Open the file browser, which then has `execute` work in steps."""
        self.by_hand = True
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def in_steps(self: Any, context: bpy.types.Context) -> set[str]:
        """Do a step at each tick of a timer; all at once without a window."""
        self.by_hand = False
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self.timer = context.window_manager.event_timer_add(0.01, window=context.window)
        self.steps = self.work(context)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self.ended(context)
            self.stopped(context, False)
            return {"CANCELLED"}
        idle = {"RUNNING_MODAL"} if self.blocks else {"PASS_THROUGH"}
        if event.type != "TIMER":
            return idle
        until = time.monotonic() + BUSY_S
        try:
            for said in self.steps:
                if said is not None and context.workspace is not None:
                    context.workspace.status_text_set(said)
                if said is None or time.monotonic() > until:
                    return idle
        except Exception as fault:
            self.ended(context)
            self.stopped(context, True)
            if not isinstance(fault, UnisimError | OSError):
                raise
            return fail(self, fault)
        self.ended(context)
        self.finished(context)
        return {"FINISHED"}

    def ended(self: Any, context: bpy.types.Context) -> None:
        """Take the timer away."""
        self.steps.close()
        context.window_manager.event_timer_remove(self.timer)
        self.timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)


class AtOnce(InSteps):
    """Such an operator that begins when its button is pressed, without a question."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.in_steps(context)


def in_thread(todo: Callable[[], T]) -> Generator[None, None, T]:
    """Return what a function returns that a thread runs meanwhile; it must not touch Blender's data.
    Raises what it raises."""
    results: list[T] = []
    faults: list[BaseException] = []

    def run() -> None:
        try:
            results.append(todo())
        except BaseException as fault:
            faults.append(fault)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(JOIN_S)
        if thread.is_alive():
            yield None
    if faults:
        raise faults[0]
    return results[0]
