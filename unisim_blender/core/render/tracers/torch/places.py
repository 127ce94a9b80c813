"""Places of the samples in the static field and behind the volume, at which the fields are queried next; no gradient
passes. In plain torch an operation at a time, by the compiled kernels a block of rays at a time, in one call."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .... import native
from ....model.fields import BackgroundModel, StaticField
from ....model.networks import two_layers_of
from ....model.scene import SceneModel
from ....model.shapes import scene_struct
from ....ops import field, propose
from ....ops.constants import QUANTILE_FLOOR
from ....ops.devices import kernel_threads
from ....ops.dispatch import on_cpu
from ....ops.propose import RaySpans
from ....ops.transmittances import weights_from_tau


class BoxSpans(NamedTuple):
    """Parts of rays (P,), in rising order, from t_near to t_far (P,), in which nothing but the ground is there."""

    ray: Tensor
    t_near: Tensor
    t_far: Tensor


def are_compiled(scene: SceneModel, like: Tensor) -> bool:
    """Return whether the compiled kernels place samples of rays like ``like``: where they serve each of the steps, and
    distances are signed."""
    own = type(scene.static) is StaticField and type(scene.background) is BackgroundModel
    if not own or not on_cpu((like,)) or scene.config.density == "volume":
        return False
    table, weights = scene.static.grid.table, two_layers_of(scene.static.network, 1)
    with torch.no_grad():
        queried = field.OPERATION.chosen(scene.static.grid.grid, table, like, *weights)
    proposed = propose.OPERATION.chosen(scene.occupancy.voxels, RaySpans(like, like, like, like), like)
    return queried == proposed == "compiled"


class _Scene:
    """A scene in the form that the kernels read, and the arrays behind it."""

    def __init__(self, scene: SceneModel) -> None:
        self.arrays: list[Tensor] = []
        own, behind = scene.static, scene.background
        self.struct = scene_struct(
            scene.config, scene.volume.size_m, beta=float(scene.beta()),
            static_field=self._field(own.grid.grid.struct, own.grid.table, *two_layers_of(own.network, 1)),
            background=self._field(behind.grid.grid.struct, behind.grid.table, *two_layers_of(behind.network, 1)),
            voxels=self._address(scene.occupancy.values), ground=self._address(scene.ground.heights),
        )  # fmt: skip

    def _field(
        self, grid: native.GridStruct, table: Tensor, w1: Tensor, w2: Tensor, bias: Tensor
    ) -> native.FieldStruct:
        shape = w1.shape[1], len(w1), len(w2)
        return native.FieldStruct(
            grid, self._address(table), 0, native.MlpStruct(*shape, *map(self._address, (w1, w2, bias)))
        )

    def _address(self, values: Tensor) -> int:
        self.arrays.append(values.detach().contiguous())
        return self.arrays[-1].data_ptr()


def static_places(
    scene: SceneModel, spans: RaySpans, boxes: BoxSpans, u: Tensor, jitter: Tensor
) -> tuple[Tensor, Tensor]:
    """Return places t (N, K'), metres, where rays stop in the static field, and the mass (N,) of the occupied voxels
    along them, by the compiled kernel: `propose` at quantiles u (N, K), the field's distances there, and `propose` at the
    quantiles that `refine_quantiles` gives for ``jitter`` (N, K'). Rows without a mass are undefined."""
    lib = native.library()
    assert lib is not None
    rays = [x.detach().contiguous() for x in (spans.origins, spans.directions, spans.t_near, spans.t_far)]
    inside = [x.detach().contiguous() for x in boxes]
    u, jitter, of = u.contiguous(), jitter.contiguous(), _Scene(scene)
    t, mass = torch.empty_like(jitter), u.new_empty(len(u))
    lib.unisim_place_static(
        ctypes.byref(of.struct), *(x.data_ptr() for x in rays), len(u), *(x.data_ptr() for x in inside),
        len(inside[0]), u.data_ptr(), u.shape[1], QUANTILE_FLOOR, jitter.data_ptr(), jitter.shape[1],
        t.data_ptr(), mass.data_ptr(), kernel_threads(),
    )  # fmt: skip
    return t, mass


def disparity(u: Tensor, t0: Tensor, far_m: float) -> Tensor:
    """Return the distances (N, K) at fractions u (N, K) of the way from t0 (N, 1) to ``far_m``, even in disparity."""
    return 1 / ((1 - u) / t0 + u / far_m)


@torch.no_grad()
def background_places(
    scene: SceneModel, o: Tensor, d: Tensor, t0: Tensor, u: Tensor, within: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the places behind the volume, whose end is t0 (N, 1), at which the background model is queried, as
    fractions of disparity (N, K'), and the lengths (N, K') of the intervals around them: most where the densities at
    fractions u (N, K) are high. ``within`` (N, K') are quantiles, one in each of as many equal parts of [0, 1]."""
    return (_places_compiled if are_compiled(scene, o) else background_places_reference)(scene, o, d, t0, u, within)


def background_places_reference(
    scene: SceneModel, o: Tensor, d: Tensor, t0: Tensor, u: Tensor, within: Tensor
) -> tuple[Tensor, Tensor]:
    """`background_places` in plain torch."""
    proposals, count = u.shape[1], within.shape[1]
    x = torch.addcmul(o[:, None], disparity(u, t0, scene.config.far_m)[..., None], d[:, None])
    tau = scene.background.density(x.reshape(-1, 3)).view(u.shape) / proposals
    weight = weights_from_tau(tau)[0] * -torch.expm1(-tau) + 1e-3
    cdf = F.pad((0.8 * weight / weight.sum(-1, keepdim=True) + 0.2 / proposals).cumsum(-1), (1, 0))
    cdf = cdf / cdf[:, -1:]
    ends = torch.linspace(0, 1, count + 1, device=o.device, dtype=o.dtype).expand(len(o), -1).contiguous()
    j = torch.searchsorted(cdf, ends, right=True).clamp(1, proposals)
    c0, c1 = cdf.gather(1, j - 1), cdf.gather(1, j)
    edges = (j - 1 + (ends - c0) / (c1 - c0)) / proposals
    width = torch.diff(edges, dim=-1)
    inside = within * count - torch.arange(count, device=o.device)
    return edges[:, :-1] + inside * width, width


def _places_compiled(
    scene: SceneModel, o: Tensor, d: Tensor, t0: Tensor, u: Tensor, within: Tensor
) -> tuple[Tensor, Tensor]:
    lib = native.library()
    assert lib is not None
    o, d, t0, u, within = (x.detach().contiguous() for x in (o, d, t0, u, within))
    of, place, width = _Scene(scene), torch.empty_like(within), torch.empty_like(within)
    lib.unisim_place_background(
        ctypes.byref(of.struct), o.data_ptr(), d.data_ptr(), t0.data_ptr(), len(o), u.data_ptr(), u.shape[1],
        within.data_ptr(), within.shape[1], place.data_ptr(), width.data_ptr(), kernel_threads(),
    )  # fmt: skip
    return place, width
