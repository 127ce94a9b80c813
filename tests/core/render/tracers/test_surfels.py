"""Renderers that need no trained scene, on a street whose exact images and sweeps are known."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import trimesh
from drive_frames import DriveFrames
from numpy.typing import NDArray
from PIL import Image
from whole_drive import bound_to
from written_street import write_recipe

from unisim_blender.core import native
from unisim_blender.core.cli.main import run
from unisim_blender.core.data.exposures import Exposures
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import LogError, SceneError
from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.files import cache_folder
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.prepare.capture_request import capture_request
from unisim_blender.core.prepare.renderers import SURFEL_METHODS
from unisim_blender.core.render import code_identity as code_identity_module
from unisim_blender.core.render.code_identity import NOT_RENDERING, code_digest
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.surfels.build import Step, build_surfels, finished, preliminary_surfels
from unisim_blender.core.render.tracers.surfels.cache import NOT_SURFELS, build_key, surfels_of
from unisim_blender.core.render.tracers.surfels.model import LIDARSIM, SurfelScene
from unisim_blender.core.render.tracers.surfels.placed import PlacedSurfels
from unisim_blender.core.render.tracers.surfels.tracer import SurfelBackend
from unisim_blender.core.render.tracers.surfels.views import open_view
from unisim_blender.core.render.tracers.warping import WarpTracer
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.sensors.frames import CameraFrame, RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.worker.protocol import read_message
from unisim_blender.core.worker.server import Jobs, Server
from unisim_blender.core.world.drive import Drive
from unisim_blender.core.world.replay import parked_boxes
from unisim_street.street import Street, load_street
from unisim_street.truth import truth_camera, truth_lidar

pytestmark = pytest.mark.skipif(native.library() is None, reason="surfels are made by the compiled kernels")
CAMERA, LIDAR, FRAME = "front_camera", "pandar64", 3
COLUMNS = 900
"""Of the sweeps: half as many as the device has."""
SOURCES = (0, 2, 4, 6)
UNTRAINED = SURFEL_METHODS
"""Frames that surfels are made of; `FRAME` is held out."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recipe(tmp_path_factory.mktemp("street") / "log", COLUMNS, seed=3, frames=7, width=192, height=108)


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("cache")
    before = os.environ.get("UNISIM_CACHE")
    os.environ["UNISIM_CACHE"] = str(folder)
    yield folder
    del os.environ["UNISIM_CACHE"]
    if before is not None:
        os.environ["UNISIM_CACHE"] = before


@pytest.fixture(scope="module")
def log(path: Path) -> Log:
    return open_log(path)


@pytest.fixture(scope="module")
def street(path: Path) -> Street:
    made = load_street(path)
    lidar = made.drive.lidars[LIDAR]
    lidar = replace(lidar, model=replace(lidar.model, columns=COLUMNS))
    return replace(made, drive=replace(made.drive, lidars={LIDAR: lidar}))


@pytest.fixture(scope="module")
def recorded(street: Street) -> CameraFrame:
    """The truth of the held-out frame, without edits."""
    return truth_camera(street, street.drive, CAMERA, FRAME)


@pytest.fixture(scope="module")
def scenes(log: Log) -> dict[str, SurfelScene]:
    return {name: finished(surfels_of(log, one.settings, SOURCES)) for name, one in UNTRAINED.items()}


def renderer(name: str, scenes: dict[str, SurfelScene], log: Log, drive: Drive | None = None) -> DriveFrames:
    return DriveFrames(
        Renderer(UNTRAINED[name].backend(scenes[name], log, SOURCES)), log.drive if drive is None else drive
    )


def edited(log: Log, *edits: dict[str, Any], of: Drive | None = None, **more: Any) -> Drive:
    document = {"format": "unisim-scenario", "version": 1, "name": "edited", "log": ".", "edits": list(edits), **more}
    return apply_scenario(scenario_from_json(document, log.path / "scenario.json"), of or log.drive, lambda path: {})


@pytest.fixture(scope="module")
def uid(log: Log, recorded: CameraFrame) -> str:
    """The moving actor that the truth shows largest in the held-out frame."""
    assert recorded.instance is not None
    counts = np.bincount(recorded.instance.reshape(-1), minlength=len(recorded.instances) + 1)[1:]
    moving = [log.drive.actors[uid].is_moving for uid in recorded.instances]
    return recorded.instances[int(np.argmax(np.where(moving, counts, 0)))]


def shows(frame: CameraFrame, uid: str) -> NDArray[np.bool_]:
    assert frame.instance is not None
    return (
        frame.instance == frame.instances.index(uid) + 1
        if uid in frame.instances
        else np.zeros(frame.instance.shape, bool)
    )


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_held_out_sweep_is_near_the_truth(
    name: str, scenes: dict[str, SurfelScene], log: Log, street: Street
) -> None:
    truth = truth_lidar(street, street.drive, LIDAR, FRAME)
    sweep = renderer(name, scenes, log).lidar(LIDAR, FRAME)
    both = truth.returned & sweep.returned
    error = np.abs(truth.depth_m - sweep.depth_m)[both]
    assert both.sum() > 0.85 * truth.returned.sum()
    assert np.median(error) < 0.03
    named = np.array([0, *(sorted(log.drive.actors).index(uid) + 1 for uid in truth.instances)])
    own = np.array([0, *(sorted(log.drive.actors).index(uid) + 1 for uid in sweep.instances)])
    assert (named[truth.instance[both]] == own[sweep.instance[both]]).mean() > 0.97
    assert np.corrcoef(truth.intensity[both], sweep.intensity[both])[0, 1] > 0.7


@pytest.mark.parametrize(("name", "least"), [("surfel", 20.0), ("warp", 21.0)])
def test_a_held_out_image_is_near_the_truth(
    name: str, least: float, scenes: dict[str, SurfelScene], log: Log, recorded: CameraFrame
) -> None:
    truth = recorded
    passes = ("rgb", "depth", "normal", "instance", "opacity", "unsupported")
    frame = renderer(name, scenes, log).camera(CAMERA, FRAME, passes)
    assert psnr(frame.rgb, truth.rgb) > least
    assert (
        frame.depth_m is not None
        and truth.depth_m is not None
        and frame.normal is not None
        and truth.normal is not None
    )
    both = np.isfinite(frame.depth_m) & np.isfinite(truth.depth_m) & (truth.depth_m < 40)
    assert both.sum() > 0.5 * (truth.depth_m < 40).sum(), "four sweeps leave out much of the walls"
    assert np.median(np.abs(frame.depth_m[both] - truth.depth_m[both])) < 0.1
    cosine = (frame.normal * truth.normal).sum(-1)[both]
    assert np.median(cosine) > 0.98
    assert frame.unsupported is not None and frame.opacity is not None
    assert frame.unsupported.mean() < 0.4 and set(np.unique(frame.opacity)) <= {0.0, 1.0}


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_region_has_the_pixels_of_the_whole(name: str, scenes: dict[str, SurfelScene], log: Log) -> None:
    one = renderer(name, scenes, log)
    whole, part = one.camera(CAMERA, FRAME), one.camera(CAMERA, FRAME, region=Region(40, 20, 100, 80))
    np.testing.assert_array_equal(part.rgb, whole.rgb[20:80, 40:100])


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_removed_actor_is_gone(name: str, scenes: dict[str, SurfelScene], log: Log, street: Street, uid: str) -> None:
    edit = {"type": "remove", "actor": uid}
    before = renderer(name, scenes, log).camera(CAMERA, FRAME, ("rgb", "depth", "instance"))
    where = shows(before, uid)
    after = renderer(name, scenes, log, edited(log, edit)).camera(CAMERA, FRAME, ("rgb", "depth", "instance"))
    assert where.sum() > 30 and uid not in after.instances
    truth = truth_camera(street, edited(log, edit, of=street.drive), CAMERA, FRAME)
    away, stays = (np.abs(image.rgb - truth.rgb)[where].mean() for image in (after, before))
    assert away < 0.9 * stays
    depth, behind = after.depth_m, before.depth_m
    assert depth is not None and behind is not None
    assert np.median(depth[where]) > np.median(behind[where]) + 3.0, "what is behind is farther away"


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_copy_stands_where_it_was_put(
    name: str, scenes: dict[str, SurfelScene], log: Log, street: Street, uid: str
) -> None:
    edit = {"type": "duplicate", "actor": uid, "id": "twin", "offset_m": [1.0, 3.5, 0.0]}
    frame = renderer(name, scenes, log, edited(log, edit)).camera(CAMERA, FRAME, ("rgb", "depth", "instance"))
    truth = truth_camera(street, edited(log, edit, of=street.drive), CAMERA, FRAME)
    ours, theirs = shows(frame, "twin"), shows(truth, "twin")
    assert theirs.sum() > 30
    assert (ours & theirs).sum() > 0.4 * (ours | theirs).sum(), "seen from one side, in four sweeps"
    assert frame.depth_m is not None and truth.depth_m is not None
    assert np.median(np.abs(frame.depth_m[ours & theirs] - truth.depth_m[ours & theirs])) < 0.2
    sweep = renderer(name, scenes, log, edited(log, edit)).lidar(LIDAR, FRAME)
    assert (sweep.returned & (sweep.instance == sweep.instances.index("twin") + 1)).sum() > 5


@pytest.mark.parametrize("name", list(UNTRAINED))
@pytest.mark.parametrize("factors", [[1.4, 1.4, 1.4], [1.0, 1.0, 1.5]], ids=str)
def test_a_scaled_actor_is_as_near_the_truth_as_it_was(
    name: str,
    factors: list[float],
    scenes: dict[str, SurfelScene],
    log: Log,
    street: Street,
    recorded: CameraFrame,
    uid: str,
) -> None:
    edit = {"type": "scale", "actor": uid, "factors": factors}
    errors, overlaps = [], []
    scaled = truth_camera(street, edited(log, edit, of=street.drive), CAMERA, FRAME)
    for drive, truth in ((log.drive, recorded), (edited(log, edit), scaled)):
        frame = renderer(name, scenes, log, drive).camera(CAMERA, FRAME, ("rgb", "depth", "instance"))
        ours, theirs = shows(frame, uid), shows(truth, uid)
        assert theirs.sum() > 30 and frame.depth_m is not None and truth.depth_m is not None
        errors.append(np.abs(frame.rgb - truth.rgb)[theirs].mean())
        overlaps.append((ours & theirs).sum() / (ours | theirs).sum())
        assert np.median(np.abs(frame.depth_m[ours & theirs] - truth.depth_m[ours & theirs])) < 0.1
    assert errors[1] < 1.25 * errors[0] and overlaps[1] > overlaps[0] - 0.05


def test_a_scaled_actor_is_looked_up_in_images_from_its_own_side(scenes: dict[str, SurfelScene], log: Log) -> None:
    uid = next(uid for uid, actor in sorted(log.drive.actors.items()) if actor.is_moving)
    drive = edited(log, {"type": "scale", "actor": uid, "factors": [1.4, 1, 1]})
    tracer = bound_to(UNTRAINED["warp"].backend(scenes["warp"], log, SOURCES), drive)
    assert isinstance(tracer, WarpTracer)
    number = tracer.active.own.uids.index(uid)
    assert tracer.edited == [i == number for i in range(len(tracer.edited))]
    # what its recorded box hid shows nothing of what is behind it now
    assert tracer.elsewhere == (uid,)


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_thing_that_nobody_annotated_is_moved(
    name: str, scenes: dict[str, SurfelScene], log: Log, street: Street, recorded: CameraFrame
) -> None:
    """The builder's skip at the right kerb, put into the other lane."""
    skip = next(
        part
        for part in street.static.parts
        if np.allclose(np.ptp(part.corners(), axis=0), [3.6, 1.84, 0.09], atol=0.02)
    )
    x, y, z = np.array([*skip.corners().mean(0)[:2], 0.78]) - street.drive.world_origin
    boxes = {"skip": {"position": [x, y, z], "yaw_deg": 0, "size_m": [3.8, 2.0, 1.5]}}
    edits = (
        {"type": "copy_static", "box": "skip", "id": "skip-b", "target": {"position": [x, y + 6.2, z], "yaw_deg": 0}},
        {"type": "remove_static", "box": "skip"},
    )
    passes = ("rgb", "depth")
    before = renderer(name, scenes, log).camera(CAMERA, FRAME, passes)
    drive = edited(log, *edits, boxes=boxes)
    after = renderer(name, scenes, log, drive).camera(CAMERA, FRAME, passes)
    still = recorded
    truth = truth_camera(street, edited(log, *edits, of=street.drive, boxes=boxes), CAMERA, FRAME)
    assert (
        before.depth_m is not None
        and after.depth_m is not None
        and truth.depth_m is not None
        and still.depth_m is not None
    )
    came, went = truth.depth_m < still.depth_m - 0.3, truth.depth_m > still.depth_m + 0.3
    assert came.sum() > 100 and went.sum() > 40
    for where in (came, went):
        error = np.abs(after.depth_m - truth.depth_m)[where]
        assert np.median(error) < 0.5 * np.median(np.abs(before.depth_m - truth.depth_m)[where])
        new, old = (np.abs(image.rgb - truth.rgb)[where].mean() for image in (after, before))
        assert new < old
    elsewhere = (truth.rgb == still.rgb).all(-1)
    assert (np.abs(after.rgb - before.rgb)[elsewhere] > 0.05).mean() < 0.03
    sweeps = [renderer(name, scenes, log, d).lidar(LIDAR, FRAME) for d in (log.drive, drive)]
    nearer = sweeps[1].returned & (sweeps[1].depth_m < sweeps[0].depth_m - 1.0)
    assert nearer.sum() > 20


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_one_backend_renders_many_drives(name: str, scenes: dict[str, SurfelScene], log: Log) -> None:
    """What a backend keeps of the last state, the static world and warped images, is not seen in another one's."""
    moving = next(uid for uid, actor in sorted(log.drive.actors.items()) if actor.is_moving)
    parked = next(uid for uid, actor in sorted(log.drive.actors.items()) if not actor.is_moving)
    drives = [log.drive, *(edited(log, {"type": "remove", "actor": uid}) for uid in (moving, parked))]
    kept = Renderer(UNTRAINED[name].backend(scenes[name], log, SOURCES))
    fresh: dict[int, tuple[bytes, bytes]] = {}
    for n in (0, 1, 2, 0, 2, 1, 1):
        if n not in fresh:
            one = renderer(name, scenes, log, drives[n])
            fresh[n] = one.camera(CAMERA, FRAME, width=96).rgb.tobytes(), one.lidar(LIDAR, FRAME).depth_m.tobytes()
        again = DriveFrames(kept, drives[n])
        assert again.camera(CAMERA, FRAME, width=96).rgb.tobytes() == fresh[n][0]
        assert again.lidar(LIDAR, FRAME).depth_m.tobytes() == fresh[n][1]
    assert len({sweep for _, sweep in fresh.values()}) == len(drives), "sweeps that are the same tell nothing"


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_mesh_stands_in_the_street(name: str, scenes: dict[str, SurfelScene], log: Log, tmp_path: Path) -> None:
    box = trimesh.creation.box([1.5, 1.5, 1.5])
    box.visual.face_colors = [255, 64, 0, 255]
    box.export(tmp_path / "cube.ply")
    place = {"position": [14.0, -1.75, 0.8], "yaw_deg": 0}
    drive = edited(log, {"type": "insert_mesh", "mesh": str(tmp_path / "cube.ply"), "id": "cube", "pose": place})
    frame = renderer(name, scenes, log, drive).camera(CAMERA, FRAME, ("rgb", "depth", "instance"))
    where = shows(frame, "cube")
    # a face of 1.5 m some 10 m ahead
    eye = log.drive.cameras[CAMERA].world_from_camera.at(log.drive.cameras[CAMERA].time_s[FRAME])[0, 3]
    model = log.drive.cameras[CAMERA].model
    wide = 192 / model.width * model.fx * 1.5 / (14.0 - 0.75 - eye)
    assert 0.8 * wide**2 < where.sum() < 1.3 * wide**2 and frame.z_depth_m is not None
    assert abs(float(np.median(frame.z_depth_m[where])) - (13.25 - eye)) < 0.1
    colour = np.median(frame.rgb[where], axis=0)
    assert colour[0] > 2 * colour[2] and colour[0] > 1.3 * colour[1]
    sweep = renderer(name, scenes, log, drive).lidar(LIDAR, FRAME)
    assert (sweep.returned & (sweep.instance == sweep.instances.index("cube") + 1)).sum() > 20


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_a_vehicle_aside_sees_the_street_from_there(
    name: str, scenes: dict[str, SurfelScene], log: Log, street: Street
) -> None:
    edit = {"type": "ego", "shift_left_m": 1.5}
    frame = renderer(name, scenes, log, edited(log, edit)).camera(CAMERA, FRAME, ("rgb", "depth"))
    truth = truth_camera(street, edited(log, edit, of=street.drive), CAMERA, FRAME)
    assert frame.depth_m is not None and truth.depth_m is not None
    near = np.isfinite(frame.depth_m) & (truth.depth_m < 30)
    assert np.median(np.abs(frame.depth_m[near] - truth.depth_m[near])) < 0.1
    assert psnr(frame.rgb, truth.rgb) > 17.0


def test_surfels_are_kept_until_their_folder_goes(log: Log, scenes: dict[str, SurfelScene]) -> None:
    again = list(surfels_of(log, LIDARSIM, SOURCES))
    assert len(again) == 1 and isinstance(again[0], SurfelScene)
    np.testing.assert_array_equal(again[0].static.vertices, scenes["surfel"].static.vertices)
    folder = cache_folder() / "surfels" / build_key(log, LIDARSIM, SOURCES)
    whole = {name: (folder / name).read_bytes() for name in ("surfels.json", "ground.npy")}
    for name, broken in (
        ("ground.npy", b""),
        ("surfels.json", b"["),
        ("surfels.json", b"[" * 100_000),
        ("surfels.json", b"[1]"),
    ):
        (folder / name).write_bytes(broken)
        assert isinstance(next(surfels_of(log, LIDARSIM, SOURCES)), Step), "what is not whole is made again"
        (folder / name).write_bytes(whole[name])
    assert isinstance(next(surfels_of(log, LIDARSIM, SOURCES)), SurfelScene)


def test_the_worker_renders_a_log_without_a_scene(path: Path, tmp_path: Path) -> None:
    log = open_log(path)
    camera = log.drive.cameras[CAMERA]
    camera = replace(camera, model=camera.model.resized(48))
    request = capture_request(log.drive, parked_boxes(log.drive), camera, 0.3, path, None)
    jobs = Jobs(tmp_path)
    first = cast(Generator[dict[str, Any], None, None], jobs.camera(request))
    told = [next(first) for _ in range(4)]
    assert all(event["event"] == "progress" for event in told)
    first.close()  # not wanted any more
    events = list(jobs.camera(request))
    progress = [event["share"] for event in events if event["event"] == "progress"]
    assert progress[0] > told[-1]["share"], "what was made before stays"
    assert events[-1]["event"] == "arrays" and (tmp_path / events[-1]["file"]).stat().st_size > 0
    assert [event["event"] for event in jobs.camera(request)] == ["arrays"], "made once"


def test_a_preliminary_scene_shows_the_frame_that_it_is_near(log: Log, recorded: CameraFrame) -> None:
    time_s = log.drive.cameras[CAMERA].time_s[FRAME]
    steps = list(preliminary_surfels(log, LIDARSIM, time_s))
    shares = [step.share for step in steps if isinstance(step, Step)]
    assert shares == sorted(shares) and len(shares) < 0.7 * len(list(build_surfels(log, LIDARSIM)))
    scene = steps[-1]
    assert isinstance(scene, SurfelScene)
    frame = DriveFrames(Renderer(SurfelBackend(scene, log.drive)), log.drive).camera(CAMERA, FRAME)
    assert psnr(frame.rgb, recorded.rgb) > 20.0


def images(jobs: Jobs, request: dict[str, Any]) -> tuple[list[bool], bytes]:
    """Whether each image of a request is preliminary, and the bytes of them."""
    events = list(jobs.camera(request))
    files = [(jobs.folder / event["file"]).read_bytes() for event in events if event["event"] == "arrays"]
    return [event["preliminary"] for event in events if event["event"] == "regions"], b"".join(files)


def test_preliminary_images_are_labelled_and_never_results(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    log = open_log(path)
    camera = log.drive.cameras[CAMERA]
    camera = replace(camera, model=camera.model.resized(48))
    asked = capture_request(log.drive, parked_boxes(log.drive), camera, 0.3, path, None)
    view = {**asked, "id": 1, "preliminary": True, "update": {"job": None, "unfinished": []}}
    jobs = Jobs(tmp_path)
    labels, first = images(jobs, view)
    assert labels == [True] and jobs.surfels is None
    assert images(jobs, {**view, "update": {"job": 1, "unfinished": []}}) == ([True], first), "never a part of one"
    steps = list(jobs.prepare({"log": str(path)}))
    assert steps and all(event["pauses"] for event in steps)
    finished_labels, refined = images(jobs, view)
    assert finished_labels == [False] and refined != first
    other = Jobs(tmp_path)
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "other_cache"))
    images(other, view)  # a preliminary scene is at hand
    assert images(other, asked) == ([], refined), "a result is of all surfels"


def test_what_pauses_lets_later_requests_go_first() -> None:
    def long(request: dict[str, Any]) -> Iterator[dict[str, Any]]:
        for _ in range(3):
            yield {"event": "progress", "pauses": True}

    events = io.BytesIO()
    server = Server(io.BytesIO(), events, {"long": long, "short": lambda request: iter(())})
    for number, do in enumerate(("long", "short", "long")):
        server.waiting.put({"id": number, "do": do})
    for _ in range(3):
        server._do(cast(dict[str, Any], server.waiting.get()))
    server.cancelled.add(0)  # while it waits
    while not server.waiting.empty():
        server._do(cast(dict[str, Any], server.waiting.get()))
    events.seek(0)
    told = [(event["id"], event["event"]) for event in iter(lambda: read_message(events), None)]
    assert told[:3] == [(0, "progress"), (1, "done"), (2, "progress")]
    assert [event for number, event in told[3:] if number == 0] == ["cancelled"]
    assert told[-1] == (2, "done") and not server.cancelled


@pytest.mark.parametrize("name", [None, "warp"])
def test_the_command_line_renders_a_log(name: str | None, path: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["--renderer", name] if name else []
    options = ["--frames", "3", "--passes", "rgb,depth,instance", "--jobs", "1", "--sources", "::2"]
    assert run(["render", str(path), "--out", str(out), *options, *arguments]) == 0
    manifest = json.loads((out / "manifest.json").read_bytes())
    assert manifest["settings"]["renderer"] == (name or "surfel")
    assert np.asarray(Image.open(out / "camera" / CAMERA / "000003.png")).std() > 20
    with np.load(out / "lidar" / LIDAR / "000003.npz") as sweep:
        assert len(sweep["x"]) > 1000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--renderer", "neural"], "names no trained scene"),
        (["--sources", "90:95"], "selects none of the frames"),
        (["--renderer", "warp", "--sensors", "nobody"], "is not one of"),
    ],
)
def test_what_cannot_be_rendered_is_a_sentence(
    arguments: list[str], words: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["render", str(path), "--out", str(tmp_path / "out"), *arguments]) == 1
    assert words in capsys.readouterr().err


def test_a_log_without_sweeps_is_a_sentence(log: Log) -> None:
    with pytest.raises(LogError, match="no LiDAR sweep"):
        next(build_surfels(log, LIDARSIM, frames=()))


def test_an_actor_of_another_scene_is_a_sentence(log: Log, scenes: dict[str, SurfelScene]) -> None:
    from dataclasses import replace

    uid, actor = next(iter(log.drive.actors.items()))
    drive = replace(log.drive, actors={uid: replace(actor, appearance=replace(actor.appearance, scene="/elsewhere"))})
    with pytest.raises(SceneError, match="/elsewhere"):
        bound_to(SurfelBackend(scenes["surfel"], log.drive), drive)


def test_no_rays_have_no_hits(log: Log, scenes: dict[str, SurfelScene]) -> None:
    tracer = bound_to(SurfelBackend(scenes["surfel"], log.drive), log.drive)
    none = Rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    traced = tracer.trace(none, {"depth", "instance", "normal"}, True, None, RenderStats())
    assert {name: each.shape for name, each in traced.maps.items()} == {
        "depth": (0,),
        "instance": (0,),
        "normal": (0, 3),
    }
    assert tracer.image(traced, none.directions, CAMERA, (1, 0)).shape == (1, 0, 3)


def test_what_shows_the_vehicle_itself_colours_nothing(scenes: dict[str, SurfelScene], log: Log) -> None:
    placed = PlacedSurfels(scenes["surfel"].static)
    model = log.drive.cameras[CAMERA].model
    row = model.height // 2
    outlines = {CAMERA: (np.full(model.width, row), model.height)}
    plain = open_view(log, CAMERA, 2, model.width, model.width, placed, (), {})
    view = open_view(log, CAMERA, 2, model.width, model.width, placed, (), outlines)
    assert view.own[row:].all() and not view.own[: row - 1].any() and not plain.own.any()
    v, u = np.mgrid[: model.height, : model.width].reshape(2, -1) + 0.5
    seen, before = (
        one.sees(u, v, plain.depth_m.reshape(-1).astype(float), False).reshape(plain.own.shape) for one in (view, plain)
    )
    assert before[row:].any() and not seen[row:].any() and np.array_equal(seen[: row - 1], before[: row - 1])
    assert plain.beyond[: row - 1].any() and not (view.beyond & view.own).any()


@pytest.mark.parametrize("name", list(UNTRAINED))
def test_images_are_exposed_as_their_camera_was(name: str, scenes: dict[str, SurfelScene], log: Log) -> None:
    before = renderer(name, scenes, log).camera(CAMERA, FRAME).rgb
    scene = scenes[name]
    times, gains = scene.exposures.by_camera[CAMERA]
    assert np.abs(gains - 1).max() < 0.1, "the street's light is everywhere the same"
    darker = replace(scene, exposures=Exposures({CAMERA: (times, gains * 0.5)}))
    after = renderer(name, {name: darker}, log).camera(CAMERA, FRAME).rgb
    if name == "surfel":
        assert np.allclose(after, before * 0.5, atol=1e-5)
    else:
        # images that are said to be exposed like the rendered image give it what they show; surfels alone are darker
        assert np.median(np.abs(after - before)) < 1e-3 < np.abs(after - before).max()


def test_surfels_of_other_code_are_not_taken(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    before = build_key(log, LIDARSIM, None)
    assert build_key(log, LIDARSIM, None) == before
    monkeypatch.setattr("unisim_blender.core.render.tracers.surfels.cache.code_digest", lambda left_out: "other")
    assert build_key(log, LIDARSIM, None) != before


def test_what_is_left_out_of_a_digest_is_there() -> None:
    core = Path(code_identity_module.__file__).parents[1]
    assert [name for name in {*NOT_SURFELS, *NOT_RENDERING} if not (core / name).exists()] == []


def test_code_that_makes_surfels_is_in_their_digest(tmp_path: Path) -> None:
    core = tmp_path / "core"
    for name in ("render/tracers/surfels/build.py", "formats/pandaset/read.py", "training/loop.py"):
        (core / name).parent.mkdir(parents=True)
        (core / name).write_text("a = 1\n")
    digests = [code_digest.__wrapped__(NOT_SURFELS, core)]
    for name in ("training/loop.py", "render/tracers/surfels/build.py", "formats/pandaset/read.py"):
        (core / name).write_text("a = 2\n")
        digests.append(code_digest.__wrapped__(NOT_SURFELS, core))
    assert digests[0] == digests[1] and len(set(digests)) == 3
