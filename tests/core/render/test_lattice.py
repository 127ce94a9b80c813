"""Pictures traced from a lattice: exact where they are traced, close where they are not, the same bits in any part."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.core.render.lattice import SparseImage, aligned, progressive_strides
from unisim_blender.core.render.tracer import Maps


class Scene:
    """A road up to a horizon, a wall's edge, and a pole as wide as a block, by pixel: what is
    narrower may be missed."""

    def __init__(
        self,
        shape: tuple[int, int],
        passes: tuple[str, ...] = ("depth", "instance", "normal", "opacity", "unsupported"),
    ):
        h, w = shape
        y, x = np.mgrid[0:h, 0:w].astype(np.float32)
        wall = x > 0.6 * w
        depth = np.where(wall, 20 + 0.01 * x, 1.6 * 400 / np.maximum(y - 0.4 * h, 1e-3))
        self.maps: Maps = {
            "depth": np.where((y <= 0.4 * h) & ~wall, np.inf, depth).astype(np.float32),
            "instance": np.where(wall, 3, 0).astype(np.int32),
            "normal": np.where(wall[..., None], np.array([-1, 0, 0], np.float32), np.array([0, 0, 1], np.float32)),
            "opacity": np.where((y <= 0.4 * h) & ~wall, 0, 1).astype(np.float32),
            "unsupported": x < 5,
        }
        self.rgb = np.stack([0.3 + 0.4 * wall, 0.2 + 0.001 * y, 0.1 + 0.0005 * x], -1).astype(np.float32)
        self.rgb[:, 7 : 7 + 9] = 0.9
        self.maps = {name: self.maps[name].reshape(h * w, *self.maps[name].shape[2:]) for name in passes}
        self.asked = np.zeros(h * w, int)

    def trace(self, numbers: NDArray[np.int64]) -> tuple[NDArray[np.float32], Maps]:
        self.asked[numbers] += 1
        return self.rgb.reshape(-1, 3)[numbers], {name: values[numbers] for name, values in self.maps.items()}

    def image(self, shape: tuple[int, int], size: int = 4, spread: float = 0.05) -> tuple[NDArray[np.float32], Maps]:
        image = SparseImage(shape)
        for _ in progressive_strides(image, size, spread, self.trace):
            pass
        return image.values.pop("rgb"), image.values


@pytest.mark.parametrize("shape", ((1, 1), (1, 40), (3, 5), (4, 4), (5, 9), (61, 83), (64, 128)))
@pytest.mark.parametrize("size", (2, 4, 8))
def test_traced_pixels_are_exact_and_the_others_close(shape: tuple[int, int], size: int) -> None:
    scene = Scene(shape)
    rgb, maps = scene.image(shape, size)
    assert scene.asked.max() == 1
    known = scene.asked > 0
    assert np.array_equal(rgb[known], scene.rgb.reshape(-1, 3)[known])
    for name, values in maps.items():
        assert values.dtype == scene.maps[name].dtype and values.shape == scene.maps[name].shape
        assert np.array_equal(values[known], scene.maps[name][known]), name
    assert np.abs(rgb - scene.rgb.reshape(-1, 3))[~known].max(initial=0) < 0.06
    for name in ("instance", "unsupported"):
        assert np.array_equal(maps[name], scene.maps[name])
    there = np.isfinite(scene.maps["depth"])
    assert np.array_equal(np.isfinite(maps["depth"]), there)
    assert np.abs(maps["depth"][there] / scene.maps["depth"][there] - 1).max(initial=0) < 1e-4
    assert np.abs(maps["normal"] - scene.maps["normal"]).max() < 1e-6
    assert np.array_equal(maps["opacity"], scene.maps["opacity"])


def test_most_pixels_are_not_traced() -> None:
    scene = Scene((128, 256), ())
    scene.image((128, 256))
    assert scene.asked.mean() < 0.2
    # but each of what stands out is
    assert scene.asked.reshape(128, 256)[:-1, [6, 7, 15, 16]].all()


def test_a_slope_is_predicted_and_what_stands_on_it_is_not() -> None:
    shape = 65, 65
    scene = Scene(shape, ())
    y, x = np.mgrid[0:65, 0:65].astype(np.float32)
    # between a block's corners more than they may differ by, less than ends something
    slope = np.stack([0.02 * x, 0.01 * y, 0.5 + 0 * x], -1)
    scene.rgb = slope.copy()
    scene.rgb[34, 42] += 0.3
    rgb = scene.image(shape)[0].reshape(65, 65, 3)
    asked = scene.asked.reshape(65, 65)
    assert asked[2::4, 2::4].all()
    assert asked[:-1, :-1].mean() < 0.14
    assert asked[32:37, 40:45].all()
    assert np.abs(rgb - scene.rgb).max() < 1e-6


def test_a_middle_that_is_off_a_little_bends_its_block() -> None:
    shape = 5, 5
    scene = Scene(shape, ())
    scene.rgb = np.zeros((5, 5, 3), np.float32) + 0.08 * (np.arange(5) > 3)[:, None].astype(np.float32)
    scene.rgb[2, 2] = 0.06
    rgb = scene.image(shape)[0].reshape(5, 5, 3)
    assert scene.asked.reshape(5, 5)[1:4, 1:4].sum() == 1
    # half of what the middle is off is left half way to the edges
    assert np.allclose(rgb[2, :4, 0], [0, 0.03, 0.06, 0.07], atol=1e-6)


def test_what_no_pass_tells_apart_is_told_by_depth() -> None:
    scene = Scene((64, 64), ("depth",))
    scene.rgb[:] = 0.5
    _, maps = scene.image((64, 64))
    there = np.isfinite(scene.maps["depth"])
    assert np.abs(maps["depth"][there] / scene.maps["depth"][there] - 1).max() < 1e-4
    assert scene.asked.mean() < 0.5


@pytest.mark.parametrize("seed", range(40))
def test_a_part_has_the_bits_of_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = int(rng.integers(20, 70)), int(rng.integers(20, 90))
    size = int(rng.choice([2, 4, 8]))
    scene = Scene(shape)
    scene.rgb += rng.uniform(0, 0.02, scene.rgb.shape).astype(np.float32)
    # something that stands out in a few places, so that blocks are split beside others that are not
    for y, x in rng.integers(0, 1 << 20, (6, 2)) % shape:
        scene.rgb[y : y + 2, x : x + 2] += 0.5
    whole = [x.reshape(*shape, -1) for x in flattened(scene.image(shape, size))]
    # on the lattice's lines too
    starts = [int(rng.integers(n) // size * size) if rng.random() < 0.7 else int(rng.integers(n)) for n in shape]
    wanted = tuple(slice(a, int(rng.integers(a + 1, n + 1))) for a, n in zip(starts, shape, strict=True))
    rows, columns = aligned((wanted[0], wanted[1]), size, shape)
    part = Scene(shape)
    cut = rows.stop - rows.start, columns.stop - columns.start
    part.rgb = scene.rgb[rows, columns]
    part.maps = {
        name: v.reshape(*shape, *v.shape[1:])[rows, columns].reshape(-1, *v.shape[1:]) for name, v in scene.maps.items()
    }
    part.asked = np.zeros(cut[0] * cut[1], int)
    inner = tuple(slice(w.start - a.start, w.stop - a.start) for w, a in zip(wanted, (rows, columns), strict=True))
    for a, b in zip(flattened(part.image(cut, size)), whole, strict=True):
        assert np.array_equal(a.reshape(*cut, -1)[inner], b[wanted])


def flattened(image: tuple[NDArray[np.float32], Maps]) -> list[NDArray[Any]]:
    return [image[0], *image[1].values()]
