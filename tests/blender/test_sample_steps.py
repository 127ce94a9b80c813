"""A scene read in steps, as a window reads it, beside the plain way that evaluates it at every frame;
operators in steps."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import bpy
import numpy as np
import pytest
from edit_cases import CASES, standing, update
from helpers import driving, ended, select

from unisim_blender.bridge.changes.variants import new_variant
from unisim_blender.bridge.importing.drive import import_source
from unisim_blender.bridge.objects.animation import curves_of
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.sampling.from_keys import by_keys_alone, sample_steps
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.scenario import scenario_to_json
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import Sampled
from unisim_blender.editing.sampled.source import open_source
from unisim_blender.features.drive.export_operators import scenario_of, scenario_steps
from unisim_blender.features.operator_bases import InSteps, in_thread

R = TypeVar("R")
LIST_ALONE = {"ridden", "span"}
"""Members of sampled objects that the edits list alone reads."""
PATH = Path("/tmp/scenario.json")


def near(a: Any, b: Any) -> bool:
    """Whether two JSON values differ in nothing but what Blender's float32 cannot tell."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(near(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(near(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float | int):
        return abs(a - b) < 2e-5 * max(1.0, abs(a))
    return bool(a == b)


def agree(quick: Sampled, slow: Sampled) -> None:
    """Assert that two readings of a scene are one."""
    assert (quick.name, quick.items) == (slow.name, slow.items)
    assert [one.name for one in quick.objects] == [one.name for one in slow.objects]
    for ours, theirs in zip(quick.objects, slow.objects, strict=True):
        assert np.abs(ours.poses - theirs.poses).max() < 2e-5, ours.name
        assert (ours.there == theirs.there).all(), ours.name
        for field in fields(ours):
            a, b = getattr(ours, field.name), getattr(theirs, field.name)
            if field.name in {"poses", "there"} | LIST_ALONE:
                continue
            assert np.allclose(a, b, atol=1e-5) if field.name == "size_m" else a == b, (ours.name, field.name, a, b)


def muted_curve(scene: Any) -> None:
    """A key's curve that is muted: what the object has counts."""
    one = standing(scene)
    for frame, x in ((0, one.location.x), (19, one.location.x + 6.0)):
        one.location.x = x
        one.keyframe_insert("location", frame=frame)
    for curve in curves_of(one):
        curve.mute = curve.array_index == 0
    one.location.x -= 6.0


def hidden_by_keys(scene: Any) -> None:
    """Keys that hide an actor in views until frame 9, and other keys that hide it for renders at both ends."""
    one = standing(scene)
    for path, keys in (
        ("hide_viewport", ((0, True), (9, False))),
        ("hide_render", ((0, True), (5, False), (15, True))),
    ):
        for frame, hidden in keys:
            setattr(one, path, hidden)
            one.keyframe_insert(path, frame=frame)


def delta_scale(scene: Any) -> None:
    standing(scene).delta_scale = (1.2, 1.2, 1.2)


def on_a_path(scene: Any) -> None:
    """A parent that is a path moves what is parented to it."""
    bpy.ops.curve.primitive_nurbs_path_add()
    path = bpy.context.active_object
    path.data.use_path, path.data.path_duration = True, 19
    path.data.eval_time = 0.0
    path.data.keyframe_insert("eval_time", frame=0)
    path.data.eval_time = 19.0
    path.data.keyframe_insert("eval_time", frame=19)
    standing(scene).parent = path


def growing(scene: Any) -> None:
    """A scale that changes after the drive."""
    one = standing(scene)
    one.keyframe_insert("scale", frame=40)
    one.scale = (2.0, 2.0, 2.0)
    one.keyframe_insert("scale", frame=60)
    scene.frame_set(0)


def driven(scene: Any) -> None:
    standing(scene).driver_add("location", 2).driver.expression = "frame * 0.1"


MORE: dict[str, Callable[[Any], None]] = {
    "nothing": lambda scene: None,
    "muted curve": muted_curve,
    "hidden by keys": hidden_by_keys,
    "delta scale": delta_scale,
    "on a path": on_a_path,
    "growing": growing,
    "driven": driven,
}


@pytest.mark.parametrize("name", [*CASES, *MORE])
def test_steps_read_what_evaluating_every_frame_reads(street: Any, name: str) -> None:
    (CASES[name][0] if name in CASES else MORE[name])(street)
    update()
    clock = Clock.of(source_of(street).drive)
    frame = street.frame_current
    quick = ended(sample_steps(street, clock))
    assert street.frame_current == frame
    agree(quick, sample_all(street, clock))


@pytest.mark.parametrize("name", ["muted curve", "delta scale", "on a path", "driven"])
def test_what_keys_alone_do_not_tell_is_evaluated(street: Any, name: str) -> None:
    assert by_keys_alone(standing(street))
    MORE[name](street)
    update()
    assert not by_keys_alone(standing(street))


@pytest.mark.parametrize("name", ["keyed", "copied", "mesh", "swapped", "ego", "camera moved", "item moved", "retimed"])
def test_the_scenario_is_the_same(street: Any, name: str) -> None:
    CASES[name][0](street)
    update()
    street.frame_end = 12
    quick = scenario_to_json(ended(scenario_steps(street, PATH)))
    slow = scenario_to_json(scenario_of(street, PATH))
    assert quick["frames"] == slow["frames"] and (quick.get("edits") or quick.get("sensors"))
    assert near(quick, slow)


def test_a_change_without_a_key_counts(street: Any) -> None:
    one = driving(street)
    one.keyframe_insert("location", frame=0)
    one.keyframe_insert("location", frame=19)
    street.frame_set(9)
    one.location.y = 2.0
    update()
    clock = Clock.of(source_of(street).drive)
    agree(ended(sample_steps(street, clock)), sample_all(street, clock))


def test_a_variant_that_no_window_shows(street: Any) -> None:
    CASES["moved"][0](street)
    CASES["mesh"][0](street)
    update()
    window = bpy.context.window_manager.windows[0]
    new_variant(window, street, "Variant 2")
    CASES["moved standing"][0](bpy.context.scene)
    update()
    clock = Clock.of(source_of(street).drive)
    agree(ended(sample_steps(street, clock)), sample_all(street, clock))


def test_stretched_time_is_refused(street: Any) -> None:
    street.render.frame_map_new = 200
    with pytest.raises(UnisimError, match="Time Stretching"):
        ended(sample_steps(street, Clock.of(source_of(street).drive)))


def test_importing_again_keeps_edits_in_steps(street: Any) -> None:
    one = driving(street)
    one.location.y = 3.0
    update()
    said = [step.what for step in import_source(street, open_source(street.unisim.log, street.unisim.scene))]
    assert "edits" in said and one.unisim.home not in said
    assert tuple(one.location) == (0.0, 3.0, 0.0)


def test_a_thread_returns_and_raises() -> None:
    go = threading.Event()

    def slow() -> int:
        go.wait()
        return threading.get_ident()

    steps = in_thread(slow)
    assert next(steps) is None
    go.set()
    assert ended(steps) != threading.get_ident()

    def wrong() -> int:
        raise UnisimError("no such drive")

    with pytest.raises(UnisimError, match="no such drive"):
        ended(in_thread(wrong))


class Counting(InSteps):
    """Works through three steps; the third fails where ``fails`` says so."""

    options = SimpleNamespace(is_invoke=False, is_repeat=False)

    def __init__(self, fails: Exception | None = None) -> None:
        self.fails, self.said, self.ends = fails, [], []  # type: ignore[var-annotated]

    def report(self, kind: set[str], text: str) -> None:
        self.said.append((kind, text))

    def work(self, context: Any) -> Generator[str | None, None, None]:
        yield "first"
        yield None
        if self.fails is not None:
            raise self.fails
        yield "third"

    def stopped(self, context: Any, fault: bool) -> None:
        self.ends.append(("stopped", fault))

    def finished(self, context: Any) -> None:
        self.ends.append(("finished", False))


class Window:
    """What `InSteps` asks a window's context for."""

    def __init__(self) -> None:
        self.window, self.window_manager, self.workspace = object(), self, self
        self.timers: list[object] = []
        self.texts: list[str | None] = []

    def event_timer_add(self, every_s: float, window: object) -> object:
        self.timers.append(object())
        return self.timers[-1]

    def event_timer_remove(self, timer: object) -> None:
        self.timers.remove(timer)

    def modal_handler_add(self, operator: object) -> None:
        pass

    def status_text_set(self, text: str | None) -> None:
        self.texts.append(text)


def begun(monkeypatch: pytest.MonkeyPatch, fails: Exception | None = None) -> tuple[Any, Window]:
    """An operator that has begun in a window."""
    window, operator = Window(), Counting(fails)
    monkeypatch.setattr(
        "unisim_blender.features.operator_bases.bpy.app", SimpleNamespace(background=False), raising=False
    )
    assert operator.in_steps(window) == {"RUNNING_MODAL"}
    return operator, window


TICK, ESC, KEY = (SimpleNamespace(type=kind, value="PRESS") for kind in ("TIMER", "ESC", "G"))


def test_an_operator_works_at_ticks_alone(street: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        operator, window = begun(patch)
        assert operator.modal(window, KEY) == {"RUNNING_MODAL"} and window.texts == []
        assert operator.modal(window, TICK) == {"RUNNING_MODAL"} and window.texts == ["first"]
        assert operator.modal(window, TICK) == {"FINISHED"} and window.texts == ["first", "third", None]
        assert operator.ends == [("finished", False)] and not window.timers


def test_esc_ends_it(street: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        operator, window = begun(patch)
        operator.modal(window, TICK)
        assert operator.modal(window, ESC) == {"CANCELLED"}
        assert operator.ends == [("stopped", False)] and not window.timers and window.texts[-1] is None


@pytest.mark.parametrize("fault", [UnisimError("no room"), OSError("no disk"), ValueError("ours")])
def test_a_fault_ends_it_and_is_told(street: Any, fault: Exception) -> None:
    with pytest.MonkeyPatch.context() as patch:
        operator, window = begun(patch, fault)
        operator.modal(window, TICK)
        if isinstance(fault, ValueError):
            with pytest.raises(ValueError, match="ours"):
                operator.modal(window, TICK)
        else:
            assert operator.modal(window, TICK) == {"CANCELLED"}
            assert operator.said == [({"ERROR"}, str(fault))]
        assert operator.ends == [("stopped", True)] and not window.timers


def test_a_script_has_it_done_at_once() -> None:
    operator = Counting()
    assert operator.execute(Window()) == {"FINISHED"}
    assert Counting(UnisimError("no room")).execute(Window()) == {"CANCELLED"}


def test_nothing_else_is_selected_by_reading(street: Any) -> None:
    one = driving(street)
    select(one)
    scenes = set(bpy.data.scenes)
    MORE["driven"](street)
    ended(sample_steps(street, Clock.of(source_of(street).drive)))
    assert bpy.context.view_layer.objects.active == one and set(bpy.data.scenes) == scenes
    assert len(list(imported_objects(street, "EGO"))) == 1
