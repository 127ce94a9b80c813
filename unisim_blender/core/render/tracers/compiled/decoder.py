"""Decoding of composited features to a sensor's measurements, with numpy and the compiled kernels. `model/decode.py` is
the specification."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....errors import SceneError, UnisimError
from ....model.config import ModelConfig
from ....model.scene_file import Weights
from ....model.shapes import (
    LIDAR_INPUTS,
    SH_WIDTH,
    Convolution,
    camera_codes,
    convolutions,
    decoder_reach,
    perceptrons,
)
from ...tracer import Array
from .structs import floats


class Decoder:
    """The heads and the camera decoder of a trained scene.

    ``weights`` are those of its file, float16 or float32, ``cameras`` the number of camera codes. ``half`` lets
    convolutions multiply bfloat16 where build and processor can; ``threads`` is `native.threads` by default. Bits
    depend neither on the number of threads nor on what else is decoded at the same time.
    """

    def __init__(
        self, weights: Weights, config: ModelConfig, cameras: int, half: bool = False, threads: int | None = None
    ) -> None:
        library = native.library()
        if library is None:
            raise UnisimError(
                "the compiled decoder needs the compiled kernels: run make setup, and leave UNISIM_NATIVE=0 away"
            )
        if config.decoder_kernel % 2 == 0:
            raise SceneError(f"decoder_kernel is {config.decoder_kernel}, not an odd number")
        self._library, self._config, self._half = library, config, half
        self._threads = native.threads() if threads is None else threads
        f, up = config.features, config.upsample

        networks = perceptrons(config)

        def perceptron(name: str) -> list[_Layer]:
            *matrices, bias = (
                floats(weights.array(part, shape)) for part, shape in networks[name].arrays(name).items()
            )
            return [
                *(_Layer(w[..., None, None], None) for w in matrices[:-1]),
                _Layer(matrices[-1][..., None, None], bias),
            ]

        def convolution(name: str, shape: Convolution) -> _Layer:
            return _Layer(*(floats(weights.array(*part)) for part in shape.arrays(f"camera_decoder.{name}").items()))

        self.reach = decoder_reach(config)
        """How many feature cells away an output pixel can depend on."""
        self._codes = floats(weights.array("ray_head.codes", camera_codes(cameras)))
        self._ray = perceptron("ray_head.network")
        *of_blocks, last = (convolution(name, shape) for name, shape in convolutions(config).items())
        # a cell's pixels by row, column and colour, as they lie in the image
        order = np.arange(3 * up**2).reshape(3, up, up).transpose(1, 2, 0).reshape(-1)
        assert last.bias is not None
        self._convolutions = [*of_blocks, _Layer(last.weight[order], last.bias[order])]
        self._lidar = _Head(f, LIDAR_INPUTS, perceptron("lidar_head.network"))
        self._sample = None
        if config.head == "sample":
            self._sample = _Head(f, 0, perceptron("sample_head"))

    def image(self, features: NDArray[Any], directions: NDArray[Any], camera: int = -1) -> Array:
        """Return the image (h up, w up, 3) in 0..1, display-referred sRGB, of features (h, w, F) seen along unit
        directions (h, w, 3), world frame.

        ``camera`` numbers the camera codes; -1 stands for a camera that was not trained and takes their mean.
        """
        h, w = directions.shape[:2]
        features, directions = _contiguous(features, (h, w, self._config.features)), _contiguous(directions, (h, w, 3))
        head = self._head(camera)
        layers = _structs(self._convolutions)
        up = self._config.upsample
        out = np.empty((h * up, w * up, 3), np.float32)
        self._library.unisim_decode_image(
            ctypes.byref(head.struct), layers, len(layers), up, features.ctypes.data, directions.ctypes.data, h, w,
            out.ctypes.data, self._half, self._threads,
        )  # fmt: skip
        return out

    def _head(self, camera: int) -> _Head:
        code = self._codes.mean(0) if camera < 0 else self._codes[camera]
        # a code that all pixels share is a bias
        first, behind = self._ray[0].weight, self._config.features + SH_WIDTH
        bias = first[:, behind:, 0, 0] @ code
        return _Head(self._config.features, 0, [_Layer(first[:, :behind], bias), *self._ray[1:]])

    def network(self, camera: int) -> tuple[native.HeadStruct, ctypes.Array[native.LayerStruct], list[Any]]:
        """Return the structures of `image` for a camera: its head, and the convolutions; and what they point to."""
        head, layers = self._head(camera), [*self._convolutions]
        arrays = [array for layer in (*head.layers, *layers) for array in (layer.weight, layer.bias)]
        return head.struct, _structs(layers), [head, *(array for array in arrays if array is not None)]

    def returns(
        self, feature: NDArray[Any], directions: NDArray[Any], depth_m: NDArray[Any], opacity: NDArray[Any]
    ) -> tuple[Array, Array]:
        """Return the intensity in 0..1 (N,) and the logit of a return (N,).

        feature (N, F), directions (N, 3) unit, world frame, depth_m (N,), metres, opacity (N,).
        """
        extra = np.stack(
            [np.log1p(np.asarray(depth_m, np.float32)) / np.float32(5), np.asarray(opacity, np.float32)], -1
        )
        out = self._run(self._lidar, feature, directions, extra)
        return sigmoid(out[:, 0]), out[:, 1]

    @property
    def lidar_network(self) -> tuple[native.HeadStruct, list[Array]]:
        """The structure of the head of `returns`, and the arrays that its layers point to."""
        arrays = [array for layer in self._lidar.layers for array in (layer.weight, layer.bias)]
        return self._lidar.struct, [array for array in arrays if array is not None]

    @property
    def sample_head(self) -> int | None:
        """The address of the head that takes the view direction at every sample; None where it enters once per ray."""
        return None if self._sample is None else ctypes.addressof(self._sample.struct)

    @property
    def sample_arrays(self) -> tuple[native.HeadStruct | None, list[Array]]:
        """That head's structure, None where there is none, and the arrays that its layers point to."""
        if self._sample is None:
            return None, []
        arrays = [array for layer in self._sample.layers for array in (layer.weight, layer.bias)]
        return self._sample.struct, [array for array in arrays if array is not None]

    def _run(self, head: _Head, feature: NDArray[Any], directions: NDArray[Any], extra: Array) -> Array:
        n = len(directions)
        feature, directions = _contiguous(feature, (n, self._config.features)), _contiguous(directions, (n, 3))
        extra, out = _contiguous(extra, (n, head.struct.extra_inputs)), np.empty((n, head.outputs), np.float32)
        self._library.unisim_head_forward(
            ctypes.byref(head.struct),
            feature.ctypes.data,
            directions.ctypes.data,
            extra.ctypes.data,
            n,
            out.ctypes.data,
            self._threads,
        )
        return out


class _Layer:
    """A convolution's weight (O, I, k, k) and bias (O,), or none, in the form that the kernels read."""

    def __init__(self, weight: Array, bias: Array | None) -> None:
        self.weight, self.bias = np.ascontiguousarray(weight), bias
        outputs, inputs, kernel = self.weight.shape[:3]
        self.struct = native.LayerStruct(
            inputs, outputs, kernel, self.weight.ctypes.data, None if bias is None else bias.ctypes.data
        )


def _structs(layers: list[_Layer]) -> ctypes.Array[native.LayerStruct]:
    return (native.LayerStruct * len(layers))(*(layer.struct for layer in layers))


class _Head:
    """A perceptron of features, a direction and extra inputs, in the form that the kernels read."""

    def __init__(self, features: int, extra_inputs: int, layers: list[_Layer]) -> None:
        self.layers, self.outputs = layers, len(layers[-1].weight)
        self._structs = _structs(layers)
        self.struct = native.HeadStruct(features, extra_inputs, len(layers), ctypes.addressof(self._structs))


def _contiguous(values: NDArray[Any], shape: tuple[int, ...]) -> Array:
    if values.shape != shape:
        raise ValueError(f"an array of shape {values.shape}, not {shape}")
    return np.ascontiguousarray(values, dtype=np.float32)


def sigmoid(x: Array) -> Array:
    """Return 1 / (1 + exp(-x)), elementwise: exp of the negative magnitude never overflows."""
    e = np.exp(-np.abs(x))
    return np.where(x >= 0, 1, e) / (1 + e)


def extended_over_edges(feature: NDArray[Any], opacity: NDArray[Any], cells: int) -> Array:
    """Return a foreign actor's features (h, w, F), divided by its opacity (h, w) and extended by ``cells`` past its
    edges.

    A cell that the actor does not cover takes the mean of the nine around it, those outside the image
    counting as empty.
    """
    f, a = (np.pad(np.asarray(x, np.float32), [(1, 1), (1, 1), (0, 0)][: x.ndim]) for x in (feature, opacity))
    inner = f[1:-1, 1:-1], a[1:-1, 1:-1]
    for _ in range(cells):
        # where a cell and its neighbours are empty, so is the mean
        filled = (a != 0) | f.any(-1)
        rows, columns = np.nonzero((inner[1] < 1e-3) & np.logical_or.reduce(list(_neighbours(filled))))
        means = [sum(x[rows + i, columns + j] for i in range(3) for j in range(3)) / np.float32(9) for x in (f, a)]
        for x, mean in zip(inner, means, strict=True):
            x[rows, columns] = mean
    extended: Array = inner[0] / np.maximum(inner[1], np.float32(1e-3))[..., None]
    return extended


def _neighbours(padded: NDArray[Any]) -> list[NDArray[Any]]:
    h, w = padded.shape[0] - 2, padded.shape[1] - 2
    return [padded[i : i + h, j : j + w] for i in range(3) for j in range(3)]


def resized(image: NDArray[Any], shape: tuple[int, int]) -> Array:
    """Return an image (h, w, C) at another ``shape`` (h', w'), bilinear, with the outer edges of its corners
    aligned."""
    out = np.asarray(image, np.float32)
    for axis, size in enumerate(shape):
        n = out.shape[axis]
        at = np.maximum(
            (np.arange(size, dtype=np.float32) + np.float32(0.5)) * np.float32(n / size) - np.float32(0.5), 0
        )
        before = at.astype(np.int64)
        weight: Array = (at - before.astype(np.float32)).reshape(-1, *(1,) * (out.ndim - axis - 1))
        below = out.take(before, axis)
        out = below + (out.take(np.minimum(before + 1, n - 1), axis) - below) * weight
    return out
