"""The compiled decoder against the torch modules: images, LiDAR returns, odd sizes, every variant that
this processor runs."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from instruction_sets import run_other
from numpy.typing import NDArray
from torch import Tensor, nn

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.errors import SceneError, UnisimError
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.decode import CameraDecoder, LidarHead, RayHead
from unisim_blender.core.model.networks import mlp
from unisim_blender.core.model.scene_file import Weights
from unisim_blender.core.model.shapes import SH_WIDTH
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracers.compiled.decoder import Decoder, extended_over_edges, resized
from unisim_blender.core.render.tracers.torch import tracer as torch_tracer

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
CONFIGS: dict[str, ModelConfig] = {
    **{name: preset(name).model for name in ("tiny", "small", "compact", "hd", "paper")},
    "three blocks": dataclasses.replace(preset("small").model, decoder_kernel=3, decoder_blocks=3, upsample=2),
    "odd widths": dataclasses.replace(
        preset("small").model, features=5, hidden=7, decoder_channels=37, decoder_kernel=5, decoder_blocks=1, upsample=4
    ),
    "one channel": dataclasses.replace(
        preset("small").model, features=1, hidden=1, decoder_channels=1, decoder_blocks=2, upsample=3
    ),
}
CAMERAS = 3
SIZES = ((1, 1), (2, 9), (23, 37), (9, 211))


def modules(config: ModelConfig) -> nn.ModuleDict:
    """What a scene decodes with, at random weights whose images are neither grey nor black and white."""
    torch.manual_seed(0)
    out = nn.ModuleDict(
        {
            "ray_head": RayHead(config, CAMERAS),
            "camera_decoder": CameraDecoder(config),
            "lidar_head": LidarHead(config),
            "sample_head": mlp(config.features + SH_WIDTH, config.hidden, config.features, layers=3),
        }
    )
    with torch.no_grad():
        for name, value in out.named_parameters():
            if name.endswith("weight"):
                value.mul_(2.0)
            elif name == "ray_head.codes":
                value.normal_()
    return out.requires_grad_(False)


@pytest.mark.parametrize("shape", ((6, 5, 5), (40, 1, 1)))
def test_cells_decoded_by_themselves_are_convolved(shape: tuple[int, int, int]) -> None:
    """Products of matrices give what convolutions of size 1 do, and their gradients."""
    torch.manual_seed(0)
    decoder = CameraDecoder(dataclasses.replace(preset("small").model, upsample=2, decoder_blocks=2))
    assert decoder.reach == 0
    b, height, width = shape
    features = torch.randn(b, decoder.last.in_channels, height, width)
    results: list[list[Any]] = []
    for convolved in (False, True):
        x = features.clone().requires_grad_()
        image = torch.sigmoid(F.pixel_shuffle(decoder.last(F.relu(decoder.blocks(x))), 2)) if convolved else decoder(x)
        decoder.zero_grad()
        image.square().sum().backward()
        results.append([image.detach(), x.grad, *(p.grad for p in decoder.parameters())])
    assert results[0][0].shape == (b, 3, 2 * height, 2 * width)
    for got, expected in zip(*results, strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5)


def weights(model: nn.Module) -> Weights:
    return Weights(Path("held.safetensors"), {name: value.numpy() for name, value in model.state_dict().items()})


def changed(held: Weights, arrays: dict[str, NDArray[Any]]) -> Weights:
    return Weights(held.file, arrays)


def seen(config: ModelConfig, *shape: int) -> tuple[Tensor, Tensor]:
    """Features and unit directions of that shape."""
    torch.manual_seed(sum(shape))
    return torch.randn(*shape, config.features), F.normalize(torch.randn(*shape, 3), dim=-1)


def plain(model: nn.ModuleDict, features: Tensor, directions: Tensor, camera: int) -> Tensor:
    h, w = features.shape[:2]
    head, decoder = model["ray_head"], model["camera_decoder"]
    assert isinstance(head, RayHead) and isinstance(decoder, CameraDecoder)
    flat = head(features.view(h * w, -1), directions.view(-1, 3), torch.full((h * w,), camera))
    out: Tensor = decoder(flat.view(1, h, w, -1).permute(0, 3, 1, 2))
    return out[0].permute(1, 2, 0)


@needs_library
@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("size", SIZES)
def test_images(name: str, size: tuple[int, int]) -> None:
    config = CONFIGS[name]
    model, (features, directions) = modules(config), seen(config, *size)
    decoder = Decoder(weights(model), config, CAMERAS, threads=1)
    wide = model.double()
    for camera in range(-1, CAMERAS):
        found = torch.from_numpy(decoder.image(features.numpy(), directions.numpy(), camera))
        assert found.dtype == torch.float32 and found.shape == (size[0] * config.upsample, size[1] * config.upsample, 3)
        torch.testing.assert_close(
            found.double(), plain(wide, features.double(), directions.double(), camera), rtol=0, atol=5e-6
        )
        torch.testing.assert_close(found, plain(model.float(), features, directions, camera), rtol=0, atol=1e-5)
        wide = model.double()
    assert size == (1, 1) or found.std() > 0.05


@needs_library
@pytest.mark.parametrize("name", ("small", "tiny", "odd widths", "paper"))
def test_any_number_of_threads_gives_the_same_bits(name: str) -> None:
    config = CONFIGS[name]
    model, (features, directions) = modules(config), seen(config, 31, 260)
    images = [
        Decoder(weights(model), config, CAMERAS, threads=n).image(features.numpy(), directions.numpy(), 0)
        for n in (1, 2, 5)
    ]
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])
    beams = seen(config, 4000)
    found = [
        np.stack(
            Decoder(weights(model), config, CAMERAS, threads=n).returns(*(x.numpy() for x in (*beams, *depths(4000))))
        )
        for n in (1, 2)
    ]
    assert np.array_equal(found[0], found[1])


@needs_library
@pytest.mark.parametrize("name", ("small", "tiny", "three blocks"))
def test_a_region_decoded_alone_has_the_bits_that_it_has_in_the_image(name: str) -> None:
    config = CONFIGS[name]
    model, (features, directions) = modules(config), seen(config, 40, 150)
    decoder, reach, up = Decoder(weights(model), config, CAMERAS), CameraDecoder(config).reach, config.upsample
    whole = decoder.image(features.numpy(), directions.numpy(), 1)
    rows, columns = slice(19 - reach, 22 + reach), slice(41 - reach, 88 + reach)
    part = decoder.image(features[rows, columns].numpy(), directions[rows, columns].numpy(), 1)
    inner = part[reach * up : (reach + 3) * up, reach * up : (reach + 47) * up]
    assert np.array_equal(inner, whole[19 * up : 22 * up, 41 * up : 88 * up])


def depths(n: int) -> tuple[Tensor, Tensor]:
    """Metres and opacities."""
    torch.manual_seed(n)
    return torch.rand(n) * 100, torch.rand(n)


@needs_library
@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("n", (0, 1, 97, 2000))
def test_returns(name: str, n: int) -> None:
    config = CONFIGS[name]
    model = modules(config)
    inputs = [*seen(config, n), *depths(n)]
    found = Decoder(weights(model), config, CAMERAS).returns(*(x.numpy() for x in inputs))
    expected = model.double()["lidar_head"](*(x.double() for x in inputs))
    single = model.float()["lidar_head"](*inputs)
    for a, b, c in zip(found, expected, single, strict=True):
        assert a.dtype == np.float32 and a.shape == (n,)
        torch.testing.assert_close(torch.from_numpy(a).double(), b, rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(torch.from_numpy(a), c, rtol=1e-5, atol=1e-5)


@needs_library
def test_stored_weights_are_float16_and_inputs_of_any_layout() -> None:
    config = CONFIGS["tiny"]
    held = weights(modules(config))
    narrow = changed(held, {name: value.astype(np.float16) for name, value in held.arrays.items()})
    wide = changed(held, {name: value.astype(np.float32) for name, value in narrow.arrays.items()})
    features, directions = (x.numpy() for x in seen(config, 6, 8))
    expected = Decoder(wide, config, CAMERAS).image(features, directions)
    assert np.array_equal(
        Decoder(narrow, config, CAMERAS).image(features.astype(np.float64), np.asfortranarray(directions)), expected
    )
    assert Decoder(narrow, config, CAMERAS).image(features[:, :0], directions[:, :0]).shape == (12, 0, 3)


@needs_library
@pytest.mark.parametrize("name", ("small", "three blocks", "paper", "odd widths"))
def test_half_precision_shows_the_same_image(name: str) -> None:
    config = CONFIGS[name]
    held, (features, directions) = weights(modules(config)), (x.numpy() for x in seen(config, 30, 150))
    exact, half = (Decoder(held, config, CAMERAS, half=half).image(features, directions, 0) for half in (False, True))
    if not native.has_half():
        assert np.array_equal(exact, half)
        return
    error = float(np.square(exact.astype(np.float64) - half).mean())
    assert error > 0, "bfloat16 was not used"
    assert -10 * np.log10(error) >= 50
    assert np.array_equal(half, Decoder(held, config, CAMERAS, half=True, threads=3).image(features, directions, 0))


@needs_library
def test_weights_that_do_not_fit_are_named() -> None:
    config = CONFIGS["tiny"]
    held = weights(modules(config))
    less = {name: value for name, value in held.arrays.items() if name != "ray_head.codes"}
    with pytest.raises(SceneError, match=r"held.safetensors: ray_head\.codes is missing"):
        Decoder(changed(held, less), config, CAMERAS)
    other = {**held.arrays, "camera_decoder.last.bias": np.zeros(11)}
    with pytest.raises(SceneError, match=r"held.safetensors: camera_decoder\.last\.bias has shape \(11,\)"):
        Decoder(changed(held, other), config, CAMERAS)
    with pytest.raises(SceneError, match="odd"):
        Decoder(held, dataclasses.replace(config, decoder_kernel=2), CAMERAS)
    with pytest.raises(ValueError, match="shape"):
        Decoder(held, config, CAMERAS).image(np.zeros((3, 4, config.features)), np.zeros((3, 5, 3)))


def test_without_the_library_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "library", lambda: None)
    with pytest.raises(UnisimError, match="compiled kernels"):
        Decoder(changed(weights(modules(CONFIGS["tiny"])), {}), CONFIGS["tiny"], CAMERAS)


def test_it_needs_no_torch() -> None:
    script = "import sys, unisim_blender.core.render.tracers.compiled.decoder; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], timeout=60).returncode == 0


@pytest.mark.parametrize("cells", (0, 8))
@pytest.mark.parametrize("shape", ((1, 1), (3, 30), (40, 33)))
def test_a_foreign_actor_is_carried_past_its_edges(shape: tuple[int, int], cells: int) -> None:
    torch.manual_seed(shape[1])
    share = torch.rand(shape) * (torch.rand(shape) < 0.03)
    share[0, 0] = 5e-4  # too little to be looked at, but something
    feature = torch.randn(*shape, 5) * share[..., None]
    feature[-1, -1] = 0.1  # of no share at all
    expected = torch_tracer._extrapolated(feature.view(-1, 5), share.view(-1), shape, cells).view(*shape, 5)
    found = extended_over_edges(feature.numpy(), share.numpy(), cells)
    torch.testing.assert_close(torch.from_numpy(found), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shape", ((1, 1), (7, 5), (14, 33), (3, 100)))
def test_bilinear_images(shape: tuple[int, int]) -> None:
    torch.manual_seed(0)
    image = torch.rand(7, 11, 3)
    expected = F.interpolate(image.permute(2, 0, 1)[None], size=shape, mode="bilinear", align_corners=False)[0].permute(
        1, 2, 0
    )
    torch.testing.assert_close(torch.from_numpy(resized(image.numpy(), shape)), expected, rtol=0, atol=1e-6)


VARIANT_SCRIPT = """
from render.tracers import test_compiled_decoder as t
assert native.variant() == "avx512" or not native.has_half()
for name in t.CONFIGS:
    t.test_images(name, (9, 31))
    t.test_returns(name, 50)
t.test_any_number_of_threads_gives_the_same_bits("tiny")
t.test_a_region_decoded_alone_has_the_bits_that_it_has_in_the_image("three blocks")
t.test_half_precision_shows_the_same_image("three blocks")
"""


@needs_library
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant(name: str) -> None:
    run_other(name, VARIANT_SCRIPT)
