"""Places of samples along rays through occupied voxels, by the compiled kernel."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ... import native
from ..constants import DECAY_PER_M
from ..devices import kernel_threads
from .voxels import RaySpans, Voxels


def propose(voxels: Voxels, spans: RaySpans, u: Tensor) -> tuple[Tensor, Tensor]:
    """See `propose.propose`."""
    n, count = u.shape
    o, d = spans.origins.contiguous(), spans.directions.contiguous()
    t_near, t_far = spans.t_near.contiguous(), spans.t_far.contiguous()
    values, u = voxels.values.contiguous(), u.contiguous()
    lib = native.library()
    assert lib is not None
    shape = np.array(voxels.values.shape, np.int32)
    lower = voxels.lower.numpy().astype(np.float32)
    voxel = np.float32(voxels.voxel_m).reshape(1)
    t, mass = torch.empty(n, count), torch.empty(n)
    lib.unisim_propose(
        o.data_ptr(), d.data_ptr(), t_near.data_ptr(), t_far.data_ptr(), n, values.data_ptr(), shape.ctypes.data,
        lower.ctypes.data, voxel.ctypes.data, voxels.voxel_m / 2, DECAY_PER_M, u.data_ptr(), count, t.data_ptr(),
        mass.data_ptr(), kernel_threads(),
    )  # fmt: skip
    return t, mass
