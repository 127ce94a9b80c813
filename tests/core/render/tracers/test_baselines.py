"""Baselines and ablations: they learn, are kept, render and are edited, or say in a sentence why not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from drive_frames import DriveFrames
from small_log import write_small_log
from small_training import SMALL
from torch import Tensor

from unisim_blender.core.cli.main import run
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import SceneError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.config import ModelConfig, SampleConfig
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.presets import PRESETS, preset
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.scenes.recipe import backend_name, environment, load_backend
from unisim_blender.core.scenes.scene import capability_warnings, open_scene
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.training.batches.data import LidarData
from unisim_blender.core.training.checkpoint import CHECKPOINT, save_checkpoint
from unisim_blender.core.training.config import TrainConfig, recipe
from unisim_blender.core.training.export import write_scene
from unisim_blender.core.training.loop import train
from unisim_blender.core.training.trainer import Trainer

KINDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "ngp": ("tiny-ngp", ()),
    "ngp without lidar": ("tiny-ngp", ("lidar",)),
    "nsg": ("tiny-nsg", ()),
    "no decoder": ("tiny", ("decoder",)),
    "no actor prior": ("tiny", ("actor-prior",)),
    "no refinement": ("tiny", ("tracklet-refinement",)),
}
"""Preset, and what it is without."""
STEPS = 40


@pytest.fixture(autouse=True, scope="module")
def small_presets() -> Iterator[None]:
    """The baselines with the sizes of ``tiny``, and what a test registers besides; gone afterwards."""
    before = dict(PRESETS)
    samples, tiny = SampleConfig(12, 8, 6, 4, 4, 2), preset("tiny").model
    for name in ("ngp", "nsg"):
        baseline = preset(name)
        shapes = baseline.model
        PRESETS[f"tiny-{name}"] = replace(
            baseline,
            model=replace(
                tiny,
                samples=samples,
                light="fixed",
                colour=shapes.colour,
                density=shapes.density,
                actors=shapes.actors,
                upsample=1,
            ),
        )
    yield
    PRESETS.clear()
    PRESETS.update(before)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("baselines") / "log"
    write_small_log(out)
    return out


@pytest.fixture(scope="module")
def log(path: Path) -> Log:
    return open_log(path)


def config_of(kind: str) -> TrainConfig:
    name, without = KINDS[kind]
    fast = (2e-2, 2e-2)
    return replace(
        SMALL, preset=name, without=without, iterations=STEPS, patches=3, patch_cells=12, lidar_rays=128,
        rate_tables=fast,
        rate_networks=fast,
    )  # fmt: skip


@dataclass(frozen=True)
class Run:
    """A training: its trainer, each step's figures, and what the learnt tensors were before."""

    trainer: Trainer
    metrics: list[dict[str, float]]
    before: dict[str, Tensor]


def learnt(trainer: Trainer) -> dict[str, Tensor]:
    return dict((*trainer.model.named_parameters(), *trainer.tracklets.named_parameters()))


@pytest.fixture(scope="module")
def runs(log: Log) -> dict[str, Run]:
    found = {}
    for kind in KINDS:
        trainer = Trainer(log, config_of(kind))
        before = {name: value.detach().clone() for name, value in learnt(trainer).items()}
        found[kind] = Run(trainer, [trainer.step() for _ in range(STEPS)], before)
    return found


@pytest.fixture(scope="module")
def trained(runs: dict[str, Run], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each kind's scene."""
    folder, found = tmp_path_factory.mktemp("baselines"), {}
    for kind, made in runs.items():
        found[kind] = folder / kind.replace(" ", "-")
        found[kind].mkdir()
        save_checkpoint(found[kind] / CHECKPOINT, made.trainer)
        write_scene(made.trainer, found[kind])
    return found


def image(scene_path: Path, frame: int = 1) -> CameraFrame:
    scene = load_scene(scene_path)
    renderer = DriveFrames(Renderer(TorchBackend(scene)), scene.header.drive)
    return renderer.camera("front_camera", frame, ("rgb", "depth", "instance", "normal"))


@pytest.mark.parametrize("kind", KINDS)
def test_its_loss_falls(runs: dict[str, Run], kind: str) -> None:
    metrics = runs[kind].metrics
    first, last = (np.mean([f["rgb"] for f in part]) for part in (metrics[:6], metrics[-6:]))
    assert last < 0.75 * first, (first, last)
    assert ("depth" in metrics[0]) == ("lidar" not in KINDS[kind][1])
    if "depth" in metrics[0]:
        assert metrics[-1]["depth"] < 0.75 * metrics[0]["depth"]
    ours = {"sdf_band", "eikonal", "normal_smoothness", "free", "distortion"}
    assert ours <= metrics[0].keys() if KINDS[kind][0] == "tiny" else not ours & metrics[0].keys()


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_reach_what_they_must(runs: dict[str, Run], kind: str) -> None:
    trainer, before = runs[kind].trainer, runs[kind].before
    after = learnt(trainer)
    changed = {name for name, value in after.items() if not torch.equal(value, before[name])}
    still = {"log_beta"} if trainer.model.config.density == "volume" else set()
    if trainer.model.config.actors == "none":
        still |= {name for name in after if name.startswith("actors.")} | {"shift_m", "turn_6d"}
    if not trainer.recipe.uses_lidar:
        still |= {name for name in after if name.startswith("lidar_head")}
    if not trainer.recipe.refines_tracklets:
        still |= {"shift_m", "turn_6d"}
    assert after.keys() - changed == still


@pytest.mark.parametrize("kind", KINDS)
def test_saved_and_loaded_it_gives_the_same_image(
    log: Log, runs: dict[str, Run], trained: dict[str, Path], kind: str
) -> None:
    scene = trained[kind]
    header = load_scene(scene).header
    method = KINDS[kind][0].removeprefix("tiny-").replace("tiny", "neural")
    assert header.training["method"] == header.method == method
    assert replace(header, training={}).method == method, "as scenes of before it was stored are told"
    assert tuple(header.training["without"]) == KINDS[kind][1]
    again = scene.with_name(f"{scene.name}-again")
    again.mkdir()
    (again / CHECKPOINT).write_bytes((scene / CHECKPOINT).read_bytes())
    train(log, config_of(kind), again, resume=True, quiet=True)
    assert (again / "weights.safetensors").read_bytes() == (scene / "weights.safetensors").read_bytes()
    shown = image(scene)
    assert (
        shown.rgb.shape == (32, 48, 3)
        and np.isfinite(shown.rgb).all()
        and 0 <= shown.rgb.min()
        and shown.rgb.max() <= 1
    )
    np.testing.assert_array_equal(image(again).rgb, shown.rgb)
    kept, model = load_scene(scene), runs[kind].trainer.model
    assert kept.actor_tables.shape == (len(model.actor_ids), *model.actors.row)
    assert not any(
        name.startswith(("actors.latents", "actors.own", "actors.hyper")) for name in kept.model.state_dict()
    )


@pytest.mark.parametrize("head", ("ray", "sample"))
def test_what_nobody_saw_teaches_no_network_its_colours(log: Log, head: str) -> None:
    """Whatever stands at the view direction's place: `UnobservedPrior` moves the tables of unobserved places alone."""
    tiny = preset("tiny")
    PRESETS["tiny-head"] = replace(tiny, model=replace(tiny.model, head=head))  # type: ignore[arg-type]
    trainer = Trainer(log, replace(config_of("no decoder"), preset="tiny-head"))
    assert trainer.model.config.colour == "sample" and trainer.model.config.head == head
    loss = trainer.unobserved.loss(torch.Generator().manual_seed(0))
    colours, static = list(trainer.model.colour_head.parameters()), list(trainer.model.static.network.parameters())
    assert all(parameter.requires_grad for parameter in colours), "and afterwards they learn again"
    found = torch.autograd.grad(loss, [*colours, *static], allow_unused=True)
    assert found == (None,) * len(found)


def test_an_image_is_the_colours_of_its_samples(trained: dict[str, Path]) -> None:
    """Whatever stands before a ray, its pixel lies among the colours that samples and sky have."""
    model = load_scene(trained["ngp"]).model
    last = model.colour_head.network[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.logit(torch.tensor([0.25, 0.5, 0.75])))
    scene = load_scene(trained["ngp"])
    scene.model.load_state_dict(model.state_dict())
    rgb = DriveFrames(Renderer(TorchBackend(scene)), scene.header.drive).camera("front_camera", 1).rgb
    np.testing.assert_allclose(rgb, np.broadcast_to([0.25, 0.5, 0.75], rgb.shape), atol=2e-3)


def edited(scene: Path, log_path: Path, out: Path, edits: list[dict[str, object]]) -> Path:
    document = {
        "format": "unisim-scenario", "version": 1, "name": "edited", "log": str(log_path), "scene": str(scene),
        "edits": edits,
    }  # fmt: skip
    out.write_text(json.dumps(document))
    return out


def rendered(scenario: Path, out: Path, *more: str) -> bytes:
    """The image of frame 1."""
    options = ["--out", str(out), "--frames", "1", "--sensors", "front_camera", "--jobs", "1", *more]
    assert run(["render", str(scenario), *options]) == 0
    return (out / "camera/front_camera/000001.png").read_bytes()


def test_a_scene_graph_is_edited(
    path: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_it_was = rendered(edited(trained["nsg"], path, tmp_path / "a.json", []), tmp_path / "a")
    removed: dict[str, object] = {"type": "remove", "actor": "car-1"}
    copied: dict[str, object] = {"type": "duplicate", "actor": "car-1", "id": "new", "world_offset_m": [0.0, 4.0, 0.0]}
    images = [as_it_was]
    for number, edits in enumerate(([removed], [copied], [copied, removed])):
        images.append(
            rendered(edited(trained["nsg"], path, tmp_path / f"{number}.json", edits), tmp_path / f"{number}")
        )
    assert len(set(images)) == len(images), "every edit is seen"
    assert "Warning" not in capsys.readouterr().err
    assert "warnings" not in json.loads((tmp_path / "1/manifest.json").read_text())["inputs"]


def test_one_field_says_that_it_has_no_actors(
    path: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_it_was = rendered(edited(trained["ngp"], path, tmp_path / "a.json", []), tmp_path / "a")
    assert "Warning" not in capsys.readouterr().err
    without_car = rendered(
        edited(trained["ngp"], path, tmp_path / "b.json", [{"type": "remove", "actor": "car-1"}]), tmp_path / "b"
    )
    warning = "scene 'ngp' is one field without actors: edits of car-1 change labels, but no image or sweep"
    assert warning in capsys.readouterr().err and without_car == as_it_was
    assert json.loads((tmp_path / "b/manifest.json").read_text())["inputs"]["warnings"] == [warning]
    shift: dict[str, object] = {"type": "ego", "shift_left_m": 1.0}
    assert rendered(edited(trained["ngp"], path, tmp_path / "c.json", [shift]), tmp_path / "c") != as_it_was
    assert "Warning" not in capsys.readouterr().err
    assert image(trained["ngp"]).instance is not None and not image(trained["ngp"]).instance.any()  # type: ignore[union-attr]


def test_a_renderer_is_what_its_scene_was_trained_as(
    path: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = edited(trained["nsg"], path, tmp_path / "a.json", [])
    named = rendered(scenario, tmp_path / "named", "--renderer", "nsg")
    assert named == rendered(scenario, tmp_path / "own")
    for name in ("named", "own"):
        assert json.loads((tmp_path / name / "manifest.json").read_text())["settings"]["renderer"] == "nsg"
    capsys.readouterr()
    assert run(["render", str(scenario), "--out", str(tmp_path / "other"), "--renderer", "ngp"]) != 0
    assert 'was trained by the method "nsg", not by "ngp"' in capsys.readouterr().err


def test_a_scene_of_a_method_without_a_renderer_is_refused(
    path: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene"
    shutil.copytree(trained["ngp"], scene)
    document = json.loads((scene / "scene.json").read_text())
    document["training"]["method"] = "splats"
    (scene / "scene.json").write_text(json.dumps(document))
    assert run(["render", str(edited(scene, path, tmp_path / "a.json", [])), "--out", str(tmp_path / "a")]) == 1
    assert 'was trained by the method "splats", for which there is no renderer here' in capsys.readouterr().err


def test_sweeps_without_lidar_are_warned_of(
    path: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = edited(trained["ngp without lidar"], path, tmp_path / "a.json", [])
    assert (
        run(
            [
                "render",
                str(scenario),
                "--out",
                str(tmp_path / "a"),
                "--frames",
                "1",
                "--sensors",
                "pandar64",
                "--jobs",
                "1",
            ]
        )
        == 0
    )
    assert "the intensities and drops of its sweeps mean nothing" in capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_kernels_do_not_take_is_torchs(trained: dict[str, Path], kind: str) -> None:
    taken = kind in ("no actor prior", "no refinement")
    scene = open_scene(trained[kind])
    drive, backend = scene.header.drive, load_backend(scene)
    name = "compiled" if taken else "torch"
    assert backend_name("cpu", [scene]) == name and ("kernels" in environment("cpu", [scene])) == taken
    assert isinstance(backend, TorchBackend) != taken
    if taken:
        wanted, got = (
            DriveFrames(Renderer(one), drive).camera("front_camera", 1).rgb
            for one in (TorchBackend(load_scene(trained[kind])), backend)
        )
        assert np.abs(wanted - got).mean() < 0.02
    else:
        with pytest.raises(
            SceneError, match=r"scene\.json: model: the compiled kernels do not take (density 'volume'|colour 'sample')"
        ):
            CompiledScene(trained[kind])


@pytest.mark.parametrize(
    ("options", "message"),
    (
        (("--preset", "ngp", "--without", "decoder"), "preset 'ngp' cannot do without 'decoder', only without lidar"),
        (
            ("--preset", "nsg", "--without", "actor-prior"),
            "preset 'nsg' cannot do without 'actor-prior', only without lidar",
        ),
        (
            ("--preset", "tiny", "--without", "lidar"),
            "cannot do without 'lidar', only without decoder, actor-prior",
        ),
        (("--preset", "tiny", "--without", "wheels"), "there is no ablation 'wheels': there are decoder, actor-prior"),
        (
            ("--preset", "ngp", "--density", "unisim"),
            "preset 'ngp' does not take a density 'unisim': it is another method's",
        ),
        (
            ("--preset", "nsg", "--adversarial"),
            "preset 'nsg' does not take an adversarial loss: it is another method's",
        ),
    ),
)
def test_what_does_not_go_together_is_said(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], message: str
) -> None:
    assert run(["train", str(path), "--out", str(tmp_path / "scene"), "--iterations", "1", "--quiet", *options]) == 1
    assert message in capsys.readouterr().err and not (tmp_path / "scene").exists()


def test_a_density_is_the_command_lines(path: Path, tmp_path: Path) -> None:
    options = [
        "--preset",
        "tiny",
        "--density",
        "unisim",
        "--without",
        "decoder, actor-prior",
        "--iterations",
        "1",
        "--quiet",
    ]
    assert run(["train", str(path), "--out", str(tmp_path / "scene"), *options]) == 0
    document = json.loads((tmp_path / "scene/scene.json").read_text())
    model, training = document["model"], document["training"]
    assert (model["density"], model["colour"], model["actors"]) == ("unisim", "sample", "tables")
    assert training["without"] == ["decoder", "actor-prior"] and training["method"] == "neural"


def test_the_presets_own_recipes() -> None:
    def of(name: str, **more: object) -> tuple[object, ...]:
        made = recipe(replace(SMALL, preset=name, **more))  # type: ignore[arg-type]
        w = made.weights
        neural = w.eikonal > 0, w.lidar_free > 0, w.chroma > 0
        return made.method, made.refines_tracklets, made.mirrored > 0, w.lidar_depth > 0, *neural

    assert of("small") == ("neural", True, True, True, True, True, True)
    assert of("small", without=("actor-prior", "tracklet-refinement")) == (
        "neural",
        False,
        False,
        True,
        True,
        True,
        True,
    )
    assert of("ngp") == ("ngp", False, False, True, False, False, False)
    assert of("nsg") == ("nsg", False, False, True, False, False, False)
    assert of("nsg", without=("lidar",)) == ("nsg", False, False, False, False, False, False)


def test_a_broken_configuration_is_refused() -> None:
    values = replace(preset("ngp").model, upsample=2).to_dict()
    with pytest.raises(SceneError, match=r"model\.upsample is 2 .* samples that have colours make one pixel"):
        ModelConfig.from_dict(values)


def test_who_asks_for_images_is_told_what_one_field_cannot_show(
    path: Path, trained: dict[str, Path], tmp_path: Path
) -> None:
    told = {}
    wanted: dict[str, list[dict[str, object]]] = {"a": [], "b": [{"type": "remove", "actor": "car-1"}]}
    for name, edits in wanted.items():
        prepared = prepare_scenario(edited(trained["ngp"], path, tmp_path / f"{name}.json", edits))
        told[name] = capability_warnings(open_scene(trained["ngp"]), prepared.recorded, prepared.edited, sweeps=False)
    assert told["a"] == [] and len(told["b"]) == 1 and "edits of car-1 change labels" in told["b"][0]


def test_without_lidar_sweeps_are_neither_needed_nor_read(path: Path, runs: dict[str, Run], tmp_path: Path) -> None:
    bare = tmp_path / "log"
    shutil.copytree(path, bare)
    for file in (bare / "lidar").glob("*.pkl.gz"):
        file.unlink()
    trainer = Trainer(open_log(bare), config_of("ngp without lidar"))
    [trainer.step() for _ in range(5)]
    again = Trainer(open_log(path), config_of("ngp without lidar"))
    [again.step() for _ in range(5)]
    wanted = learnt(again)
    for name, value in learnt(trainer).items():
        assert torch.equal(value, wanted[name]), name
    assert torch.equal(trainer.model.ground.heights, again.model.ground.heights)
    assert isinstance(trainer.lidar, LidarData) and len(trainer.lidar.points) == 0
    # the ground goes on from where the vehicle drove, in the volume's own axes
    drive = trainer.log.drive
    below = np.asarray(trainer.model.ground.height(trainer.model.frame.points(trainer.model.frame.recentred(
        drive.world_from_ego.positions
    ))).cpu())  # fmt: skip
    places = trainer.model.frame.points(trainer.model.frame.recentred(drive.world_from_ego.positions)).cpu().numpy()
    assert np.abs(below - places[:, 2]).max() < 0.3
    write_scene(trainer, tmp_path / "scene")
    assert read_scene_header(tmp_path / "scene").training["lidars"] == []
