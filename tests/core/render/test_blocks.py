"""Blocks of an image by the kernels: what plain numpy says of them, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.render import lattice
from unisim_blender.core.render.lattice import (
    NEAR_BOXES,
    SparseImage,
    differ,
    fill,
    plain_differ,
    plain_fill,
    plain_predicted,
    predicted,
)

pytestmark = pytest.mark.skipif(native.library() is None, reason="the kernels were not built")
SHAPE = 97, 145


def made(seed: int, size: int, roughness: float) -> tuple[SparseImage, NDArray[np.int64]]:
    """An image traced on a lattice of ``size`` and in every third block's middle, and its blocks. Slopes of all kinds,
    with infinite depths, numbers that are none, and jumps."""
    rng = np.random.default_rng(seed)
    h, w = SHAPE
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)

    def noise(*more: int) -> NDArray[np.float32]:
        return rng.normal(0, roughness, (h, w, *more)).astype(np.float32)

    depth = 1 / (0.0002 * y + 0.02 + 0.003 * np.abs(noise()))
    depth[rng.random(SHAPE) < 0.01] = np.inf
    rgb = np.stack([0.01 * x, 0.005 * y, 0.5 + 0 * x], -1) + noise(3)
    rgb[rng.random(SHAPE) < 0.003] = np.nan
    normal = np.stack([0.1 * np.sin(x / 9), 0.1 * np.cos(y / 7), 1 + 0 * x], -1) + noise(3)
    maps = {
        "rgb": rgb,
        "depth": depth,
        "normal": normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        "opacity": noise() + 0.9,
        "instance": (rng.random(SHAPE) < 0.01).astype(np.int32),
        "unsupported": rng.random(SHAPE) < 0.01,
        NEAR_BOXES: rng.random(SHAPE) < 0.005,
    }
    image = SparseImage(SHAPE)
    corners = (np.mgrid[0 : h - 1 : size, 0 : w - 1 : size]).reshape(2, -1).T
    image.known[::size, ::size] = True
    middles = corners[::3] + size // 2
    image.known[middles[:, 0], middles[:, 1]] = True
    numbers = np.flatnonzero(image.known)
    for name, values in maps.items():
        kind = np.float32 if values.dtype.kind == "f" else values.dtype
        image.put(numbers, {name: values.reshape(h * w, *values.shape[2:])[numbers].astype(kind)})
    return image, corners


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("size", "roughness"), ((2, 0.02), (4, 0.002), (8, 0.005)))
@np.errstate(invalid="ignore", divide="ignore")
def test_the_kernels_have_numpys_bits(seed: int, size: int, roughness: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", str(1 + seed % 3))
    image, some = made(seed, size, roughness)
    got, wanted = differ(image, some, size, 0.03), plain_differ(image, some, size, 0.03)
    assert wanted[0].any() and wanted[1].any() and not wanted[0].all()
    for a, b in zip(got, wanted, strict=True):
        assert np.array_equal(a, b)
    asked = some[::3]
    alike = plain_predicted(image, asked, size, 0.03)
    assert alike.any() and not alike.all()
    assert np.array_equal(predicted(image, asked, size, 0.03), alike)
    other, _ = made(seed, size, roughness)
    leaves = some[~wanted[0]]
    before = {name: values.copy() for name, values in image.values.items()}
    fill(image, leaves, size)
    plain_fill(other, leaves, size)
    for name, values in other.values.items():
        assert values.dtype == image.values[name].dtype
        assert np.array_equal(image.values[name], values, equal_nan=values.dtype.kind == "f"), name
        assert not np.array_equal(before[name], values, equal_nan=values.dtype.kind == "f") or name in (
            NEAR_BOXES,
            "unsupported",
            "instance",
        )


def test_maps_that_the_kernels_do_not_know_are_numpys(monkeypatch: pytest.MonkeyPatch) -> None:
    image, some = made(0, 4, 0.002)
    image.values["depth"] = image.values["depth"].astype(np.float64)
    monkeypatch.setattr(lattice, "_call", None)
    assert differ(image, some, 4, 0.03)[0].any()


@pytest.mark.parametrize("size", [2, 4])
def test_maps_that_do_not_decide_are_filled_all_the_same(size: int) -> None:
    """What an edit needs, and the request does not: blocks are split as without these maps."""
    image, blocks = made(3, size, 0.002)
    asked = SparseImage(
        SHAPE, values={name: x for name, x in image.values.items() if name not in ("depth", "instance")}
    )
    image.undeciding = {"depth", "instance"}
    for judge in (differ, plain_differ):
        for own, without in zip(judge(image, blocks, size, 0.02), judge(asked, blocks, size, 0.02), strict=True):
            assert np.array_equal(own, without) and own.any()
    for foretell in (predicted, plain_predicted):
        assert np.array_equal(foretell(image, blocks, size, 0.02), foretell(asked, blocks, size, 0.02))
    plain, _ = made(3, size, 0.002)
    fill(image, blocks, size)
    plain_fill(plain, blocks, size)
    for name in ("depth", "instance"):
        assert np.array_equal(image.values[name], plain.values[name], equal_nan=True), name
