"""What is shown after an operator is true, and times are the log's."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving, edited, imported, read, select

from unisim_blender.bridge.importing.drive import set_colours
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.scenario.edits import Move
from unisim_blender.features.output.operators import UNISIM_OT_render_sequence
from unisim_blender.process import background
from unisim_blender.process.tasks import SequenceTask


def test_a_retimed_box_stands_where_it_is_now(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    select(one)
    street.frame_set(10)
    before = one.matrix_world.translation.copy()
    assert bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.5) == {"FINISHED"}
    drive = source_of(street).drive
    then = drive.actors[uid].world_from_actor.at(drive.time_s[10] - 0.5)[:3, 3]
    assert np.array(one.matrix_world.translation) == pytest.approx(then, abs=1e-3)
    assert (one.matrix_world.translation - before).length > 0.1


@pytest.mark.parametrize("fps", [10, 25, 60])
def test_a_delay_is_in_seconds_of_the_log_at_any_frame_rate(street: Any, fps: int) -> None:
    street.render.fps, street.render.fps_base = fps, 1.0
    street.frame_step = 3
    uid = driving(street).unisim.uid
    select(imported(street, "ACTOR", uid))
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.4)
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.later_s == pytest.approx(0.4)
    recorded, now = source_of(street).drive.actors[uid].world_from_actor, edited(street).actors[uid].world_from_actor
    assert now.at(1.0) == pytest.approx(recorded.at(0.6), abs=2e-3)


def test_time_stretching_is_refused(street: Any) -> None:
    street.render.frame_map_old, street.render.frame_map_new = 100, 50
    with pytest.raises(UnisimError, match="Time Stretching takes frame 100 to 50"):
        read(street)


def test_a_log_without_a_trained_scene_may_be_rendered_as_a_sequence(street: Any) -> None:
    street.unisim.scene = ""
    assert UNISIM_OT_render_sequence.poll(bpy.context)


def test_every_operator_says_why_it_is_grey(scene: Any) -> None:
    from unisim_blender.addon import MODULES
    from unisim_blender.registering import classes_of

    set_colours(scene)  # else showing colours as recorded is allowed
    said = []
    for module in MODULES:
        for cls in classes_of(module):
            if (
                not issubclass(cls, bpy.types.Operator) or cls.__name__ == "UNISIM_OT_scroll_timeline"
            ):  # the wheel's, no button
                continue
            if "poll" in vars(cls) or any("poll" in vars(base) for base in cls.__mro__[1:2]):
                name = cls.bl_idname
                group, operator = cls.bl_idname.split(".")
                called = getattr(getattr(bpy.ops, group), operator)
                if called.poll():  # it needs only that nothing runs
                    continue
                said.append(name)
                with pytest.raises(RuntimeError) as refused:
                    called()
                assert "poll() failed, context is incorrect" not in str(refused.value), name
    assert len(said) > 15


class Slow(SequenceTask):
    """A task that goes on until it is told otherwise, without a process."""

    finished = 12

    @property
    def done(self) -> float:
        """As many frames as the test says."""
        return float(self.finished)


def test_cancel_says_how_many_frames_are_finished_when_it_has_ended(tmp_path: Any) -> None:
    task = Slow([], tmp_path, 20.0)
    task.cancel()
    assert task.running and task.text() == "Stopping: 12 of 20 frames"
    task.finished, task.code = 16, 1
    assert task.text().startswith("Stopped at 16 of 20 frames")


def test_what_runs_is_watched_when_another_file_is_opened(
    street: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    registered: list[dict[str, Any]] = []
    window = SimpleNamespace(
        background=False,
        timers=SimpleNamespace(register=lambda *_, **how: registered.append(how), is_registered=lambda _: False),
    )
    monkeypatch.setattr(
        background, "bpy", SimpleNamespace(app=window, context=bpy.context, data=bpy.data, path=bpy.path)
    )
    task = Slow([], tmp_path, 20.0)
    monkeypatch.setattr(task, "start", lambda: None)
    background.launch(task)
    assert registered and registered[0]["persistent"]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    background.watch()
    assert "12 of 20" in task.line
    background.running.clear()


class Ending(Slow):
    """A task that ends while it is asked how far it is."""

    @property
    def done(self) -> float:
        """As many frames as were finished at that moment."""
        before, self.finished, self.code = self.finished, 16, 1
        return float(before)


def test_a_task_that_ends_while_it_is_looked_at_is_told_of_once_more(scene: Any, tmp_path: Any) -> None:
    task = Ending([], tmp_path, 20.0)
    task.cancelled = True
    background.running[:] = [task]
    while background.watch() is not None:
        pass
    assert task.line.startswith("Stopped at 16 of 20 frames")
    assert not background.running


def test_a_window_is_redrawn_for_news_alone(scene: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its redraw takes time that the renderers lack: not at every look, but when more is done, or after a while."""
    task = Slow([], tmp_path, 20.0)
    background.running[:] = [task]
    background.reported.clear()
    looks: list[str] = []
    monkeypatch.setattr(background, "tell", lambda told: looks.append(told.text()))
    for _ in range(5):
        assert background.watch() == background.POLL_S
    assert len(looks) == 1
    task.finished += 1
    background.watch()
    task.cancelled = True
    background.watch()
    background.watch()
    assert len(looks) == 3
    background.reported_at[0] -= background.REPORT_S
    background.watch()
    assert len(looks) == 4
    task.code = 0
    assert background.watch() is None and len(looks) == 5


def test_a_look_that_fails_is_not_the_last(scene: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Slow([], tmp_path, 20.0)
    background.running[:] = [task]
    with monkeypatch.context() as broken:
        broken.setattr(task, "measure", lambda: 1 / 0)
        assert background.watch() == background.POLL_S
    task.code = 0
    assert background.watch() is None and not background.running
    assert "Done" in task.line


def test_frames_of_an_earlier_range_are_not_counted(tmp_path: Any) -> None:
    (tmp_path / ".state").mkdir()
    for frame in range(30):
        (tmp_path / ".state" / f"{frame:06d}.json").write_text("{}")
    task = SequenceTask([], tmp_path, 10.0)
    task.wanted = range(25, 35)
    assert task.measure() == "5 of 10 frames"
