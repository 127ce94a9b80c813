"""What stands still and what is far away; actors are in actors.py. Each field maps points to one number and a feature.

The number s says what stops a ray: it is a signed distance in metres or, where the configuration's density is ``volume``, minus
the logarithm of a density in 1 / metres. Either way it rises towards what is empty. The far field gives densities.
"""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor, nn

from .. import native
from ..ops.constants import MAX_LOG_DENSITY
from ..ops.devices import kernel_threads
from ..ops.gradient_sink import GradientSink
from ..ops.grid_shape import GridArrays, GridShape
from ..ops.hash_grid import encode, tensors_of
from ..ops.kernel_choice import kernels_for
from .config import ModelConfig
from .networks import mlp, network_struct, run_mlp
from .shapes import background_grid, perceptrons, static_grid
from .volume import Volume
from .volume_frame import VolumeFrame, contract, contract_direction

INITIAL = {"logistic": 0.1, "unisim": 0.1, "volume": 3.5}
"""What a new static field says everywhere: a distance of 0.1 m, or a density that lets most of a ray through for 30 m."""

INITIAL_LOG_DENSITY = -1.0
"""Of the far field."""


def query(
    grid: GridArrays,
    table: Tensor,
    network: nn.Sequential,
    x: Tensor,
    index: Tensor | None = None,
    outputs: int | None = None,
    sink: GradientSink | None = None,
) -> Tensor:
    """What ``network`` says of the encodings of points x (N, 3) in the unit cube: its first ``outputs`` columns, or all.

    `encode` and `run_mlp`, as one kernel where no gradient is asked for.
    """
    first, last = network[0], network[-1]
    assert isinstance(first, nn.Linear) and isinstance(last, nn.Linear)
    learns = torch.is_grad_enabled() and (x.requires_grad or table.requires_grad or last.weight.requires_grad)
    kernels = None if learns or len(network) != 3 else kernels_for(x, table, last.weight)
    if kernels is None:
        return run_mlp(network, encode(grid, table, x, index, sink), outputs)
    w1, w2, bias = (w.detach().contiguous() for w in (first.weight, last.weight[:outputs], last.bias[:outputs]))
    x, table = x.detach().contiguous(), table.detach().contiguous()
    numbers = None if index is None else index.to(torch.int32).contiguous()
    if kernels == "triton":
        from ..ops.triton.grid import field_forward

        return field_forward(tensors_of(grid.shape, str(x.device)), table, x, numbers, w1, w2, bias)
    lib = native.library()
    assert lib is not None
    out = torch.empty(len(x), len(w2))
    status = lib.unisim_field_forward(
        ctypes.byref(grid.struct), x.data_ptr(), None if numbers is None else numbers.data_ptr(), len(x), table.data_ptr(),
        ctypes.byref(network_struct(w1, w2, bias)), out.data_ptr(), kernel_threads(),
    )  # fmt: skip
    assert status == 0, status
    return out


class HashTable(nn.Module):
    """A learnable table of one grid. Training may give it a sink for its gradients, see `encode`."""

    def __init__(self, shape: GridShape) -> None:
        super().__init__()
        self.grid = GridArrays(shape)
        self.table = nn.Parameter(torch.empty(shape.rows, shape.features).uniform_(-1e-4, 1e-4))
        self.sink: GradientSink | None = None

    def ask(self, network: nn.Sequential, x: Tensor, outputs: int | None = None) -> Tensor:
        """What a network says of the encodings of points (N, 3) in the unit cube."""
        return query(self.grid, self.table, network, x, outputs=outputs, sink=self.sink)


def start_at(network: nn.Sequential, s: float) -> None:
    """A new field is empty: a ray comes through it."""
    last = network[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias[0] = s


def parts(out: Tensor) -> tuple[Tensor, Tensor]:
    """The first column (N,) and the others (N, F); their gradients are put together in one go."""
    first, others = out.split((1, out.shape[1] - 1), 1)
    return first[:, 0], others


def _density(raw: Tensor) -> Tensor:
    return torch.exp(raw.clamp_max(MAX_LOG_DENSITY))


class StaticField(nn.Module):
    """Everything that stands still inside the volume."""

    def __init__(self, config: ModelConfig, volume: Volume) -> None:
        super().__init__()
        self.grid = HashTable(static_grid(config, volume.size_m))
        self.network = mlp(*perceptrons(config)["static.network"])
        self.register_buffer("size_m", torch.as_tensor(volume.size_m).float(), persistent=False)
        start_at(self.network, INITIAL[config.density])

    size_m: Tensor

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """s (N,) and features (N, F) at points (N, 3) in volume coordinates."""
        return parts(self.grid.ask(self.network, x / self.size_m))

    def distance(self, x: Tensor) -> Tensor:
        """s (N,) alone: the last layer's other rows are not computed."""
        return self.grid.ask(self.network, x / self.size_m, 1)[:, 0]


class FarField(nn.Module):
    """Everything beyond the volume, up to the sky, in contracted coordinates about the volume's centre."""

    def __init__(self, config: ModelConfig, volume: Volume) -> None:
        super().__init__()
        self.grid = HashTable(background_grid(config))
        self.network = mlp(*perceptrons(config)["far.network"])
        self.radius_m = float(min(volume.size_m[:2]) / 2)
        self.frame = VolumeFrame(volume)
        last = self.network[-1]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            # nearly empty: the sky comes first, and matter where it moves against the sky
            last.bias[0] = INITIAL_LOG_DENSITY

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Densities (N,), optical depth over the whole way beyond the volume, even in disparity, and features (N, F) at points
        (N, 3) in volume coordinates."""
        raw, feature = parts(self.grid.ask(self.network, self._contracted(x)))
        return _density(raw), feature

    def density(self, x: Tensor) -> Tensor:
        """Densities (N,) alone."""
        return _density(self.grid.ask(self.network, self._contracted(x), 1)[:, 0])

    def _contracted(self, x: Tensor) -> Tensor:
        return contract(x - self.frame.size_m / 2, self.radius_m)

    def sky(self, d: Tensor) -> Tensor:
        """Features (N, F) at infinity, along directions (N, 3) in volume axes."""
        return self.grid.ask(self.network, contract_direction(d))[:, 1:]
