"""How many threads torch and the kernels take; and that everything a GPU is asked for is on it, by one
that is pretended."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from analytic_scene import still
from pretend_device import DEVICE, Pretended, pretended_gpu
from random_scene import CONFIGS, PASSES, TINY, edited, image_rays, saved
from small_log import write_small_log
from whole_drive import bound_to

from unisim_blender.core import native
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.meshes.hits import MeshHits
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.ops.devices import kernel_threads, torch_threads, zeros_on_demand
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.training.checkpoint import load_checkpoint, save_checkpoint
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.export import write_scene
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.drive import Appearance


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory that is held is read from Linux's files")
def test_zeros_take_memory_as_they_are_written_to() -> None:
    def held() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    before, rows = held(), 1 << 20
    zeros = zeros_on_demand((rows, 256))
    assert zeros.shape == (rows, 256) and zeros.dtype == torch.float32 and not zeros[:: rows // 64].any()
    zeros[7] = 1.0
    assert float(zeros[:9].sum()) == 256 and held() - before < zeros.nbytes / 10
    marks = zeros_on_demand((3, 4), torch.bool)
    marks[1, 2] = True
    assert marks.dtype == torch.bool and marks.sum() == 1 and zeros_on_demand((2,), torch.int32).dtype == torch.int32


def test_the_kernels_keep_their_threads_where_torch_gives_them_up() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        assert kernel_threads() == 3
        with torch_threads(1):
            assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
            with torch_threads(None):
                assert (torch.get_num_threads(), kernel_threads()) == (3, 3)
            assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
        with pytest.raises(ZeroDivisionError), torch_threads(2):
            _ = 1 / 0
        assert (torch.get_num_threads(), kernel_threads()) == (3, 3)
    finally:
        torch.set_num_threads(before)


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Without compiled kernels, so that both devices do the same."""
    monkeypatch.setattr(native, "library", lambda: None)
    return monkeypatch


def test_the_pretended_device_refuses_what_a_gpu_refuses(plain: pytest.MonkeyPatch) -> None:
    with pretended_gpu(plain):
        there, here = torch.ones(3, device=DEVICE), torch.ones(3)
        assert isinstance(there, Pretended) and there.device == DEVICE and not isinstance(here, Pretended)
        for mixed in ("there + here", "torch.cat([here, there])", "here[there > 0]", "here.add_(there)"):
            with pytest.raises(RuntimeError, match="two devices"):
                eval(mixed)
        with pytest.raises(RuntimeError, match="numpy"):
            there.numpy()
        assert (there * 2 + here.to(DEVICE)).cpu().tolist() == [3.0, 3.0, 3.0] and float(there.sum()) == 3


@pytest.mark.filterwarnings("ignore:.*copying from a non-meta parameter:UserWarning")
@pytest.mark.parametrize(
    "changes",
    [
        {},
        *(
            pytest.param(each, marks=pytest.mark.slow)
            for each in ({"adversarial": True}, {"preset": "ngp"}, {"preset": "nsg"})
        ),
    ],
    ids=str,
)
def test_a_training_keeps_to_its_device(tmp_path: Path, plain: pytest.MonkeyPatch, changes: dict[str, Any]) -> None:
    write_small_log(tmp_path / "log")
    log = open_log(tmp_path / "log")
    config = TrainConfig(
        cameras=("front_camera",), lidars=("pandar64",), frames=(0, 1, 2, 3), iterations=100, patches=2, patch_cells=8,
        lidar_rays=64, perceptual_from=0.0, poses_from=0.0, unobserved_from=0.0, settled_from=0.0, prune_from=0,
        **{"preset": "tiny", **changes},
    )  # fmt: skip
    trainer = Trainer(log, config)
    wanted = [trainer.step() for _ in range(3)]
    write_scene(trainer, tmp_path / "here")
    with pretended_gpu(plain):
        other = Trainer(log, dataclasses.replace(config, device=str(DEVICE)))
        assert all(isinstance(p, Pretended) for p in other.model.parameters())
        got = [other.step() for _ in range(2)]
        save_checkpoint(tmp_path / "kept", other)
        other = Trainer(log, dataclasses.replace(config, device=str(DEVICE)))
        load_checkpoint(tmp_path / "kept", other)
        got += [other.step()]
        write_scene(other, tmp_path / "there")
    for a, b in zip(got, wanted, strict=True):
        assert a == pytest.approx(b, rel=2e-3, abs=1e-4)
    here, there = load_scene(tmp_path / "here"), load_scene(tmp_path / "there")
    for name, value in here.model.state_dict().items():
        assert torch.allclose(value.float(), there.model.state_dict()[name].float(), atol=0.02), name


@pytest.mark.parametrize("name", CONFIGS)
def test_a_render_keeps_to_its_device(tmp_path: Path, plain: pytest.MonkeyPatch, name: str) -> None:
    drive = edited()
    foreign = still(
        "guest", (-15, 0, 1.5), (3.9, 2.4, 3.0), yaw=0.3, appearance=Appearance("car", "other"), scale=(1.3, 0.8, 1.0)
    )
    drive = dataclasses.replace(drive, actors={**drive.actors, "guest": foreign})
    folder = saved(tmp_path / "scene", CONFIGS[name])
    other = saved(tmp_path / "other", dataclasses.replace(TINY, features=7, upsample=CONFIGS[name].upsample), seed=1)

    def rendered(device: str) -> list[Any]:
        tracer = bound_to(TorchBackend(load_scene(folder, device), others={"other": load_scene(other, device)}), drive)
        out: list[Any] = []
        for rays, sky in (
            (image_rays(drive, 4), True),
            (lidar_rays(drive.lidars["top"], drive.lidars["top"].time_s[2]), False),
        ):
            few = np.arange(0, rays.time_s.size, 37)
            mesh_hits = MeshHits(
                few, np.full(len(few), 3.0), np.full(len(few), 0.5), np.zeros((len(few), 3)) + 0.5, few % 2
            )
            found = tracer.trace(rays, PASSES, sky, mesh_hits, RenderStats())
            out += [found.maps[key] for key in sorted(found.maps)]
            directions = rays.flat().directions
            out += (
                [tracer.image(found, directions, "front", rays.time_s.shape)]
                if sky
                else tracer.returns(found, directions)
            )
        return [*out, tracer.heights(rays.origins.reshape(-1, 3)[:5])]

    wanted = rendered("cpu")
    with pretended_gpu(plain):
        got = rendered(str(DEVICE))
    assert len(got) == len(wanted) == 2 * len(PASSES) + 4
    for a, b in zip(got, wanted, strict=True):
        assert type(a) is np.ndarray and np.array_equal(a, b)
