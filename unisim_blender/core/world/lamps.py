"""Lamps of actors that a log shows in two states: which it shows when, and how the lamp's part of the box looks in each."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, bilinear, intersect_boxes
from ..json_file import Node

STATES = ("off", "on", "red", "amber", "green")
"""All states that lamps are recognised in."""


@dataclass(frozen=True, eq=False)
class LampPatch:
    """Part of a box's face that changes with a lamp. ``axis`` (0 to 2) and ``side`` (-1 or 1) name the face; the others of the
    box's axes, in order, are the texture's rows and columns.

    ``low`` (2,): where the first texel begins, metres from the box's centre; ``colours`` (2, H, W, 3): sRGB in each of the two
    states; ``share`` (H, W), 0 to 1: how much of a pixel these replace.
    """

    axis: int
    side: int
    low: FloatArray
    texel_m: float
    colours: NDArray[np.float32]
    share: NDArray[np.float32]

    def drawn(self, origins: FloatArray, directions: FloatArray, size_m: FloatArray, state: int) -> tuple[Any, Any]:
        """Return colours (N, 3) of a state, and shares (N, 1), for rays (N, 3), (N, 3) in the frame of the box of ``size_m`` (3,)
        that enter it: zero for those that do by another face."""
        point = origins + intersect_boxes(origins, directions, np.eye(4)[None], size_m[None])[0] * directions
        entered = np.abs(point[:, self.axis] - self.side * size_m[self.axis] / 2) < 1e-9
        at = (np.delete(point, self.axis, 1) - self.low) / self.texel_m + 1.0
        layers = np.concatenate([self.colours[state], np.ones((*self.share.shape, 1))], -1) * self.share[..., None]
        value = bilinear(np.pad(layers, ((1, 1), (1, 1), (0, 0))), at[:, 1], at[:, 0])
        return value[:, :3] / np.maximum(value[:, 3:], 1e-6), value[:, 3:] * entered[:, None]


@dataclass(frozen=True, eq=False)
class ActorLamp:
    """A lamp of an actor, or several that change together. ``name`` is its colour, and the side that it is on: "red", "amber
    left"; of two that alternate both colours: "red-green".

    ``states`` are "off" and "on", or the colours that are lit. From ``times_s`` (K,), seconds, on it shows state ``shown`` (K,),
    and the first before, too. ``certainty``: mean probability of the states that were recognised in a log's images.
    """

    name: str
    states: tuple[str, ...]
    times_s: FloatArray
    shown: NDArray[np.int64]
    patches: tuple[LampPatch, ...]
    certainty: float = 1.0

    def at(self, time_s: float) -> ActorLamp:
        """Return the lamp in the state of a time alone."""
        number = max(int(np.searchsorted(self.times_s, time_s, "right")) - 1, 0)
        return replace(self, times_s=np.zeros(1), shown=self.shown[number : number + 1])

    def switched(self, state: str, from_s: float, to_s: float) -> ActorLamp:
        """Return the lamp in a state from one time to another."""
        before, later = self.times_s < from_s, self.times_s > to_s
        times = np.concatenate([self.times_s[before], [from_s, to_s], self.times_s[later]])
        shown = [*self.shown[before], self.states.index(state), *self.at(to_s).shown, *self.shown[later]]
        if not before.any() and np.isfinite(from_s):
            times, shown = np.concatenate([[-np.inf], times]), [self.shown[0], *shown]
        return replace(self, times_s=times, shown=np.array(shown, np.int64))

    @cached_property
    def content(self) -> bytes:
        """All of it as JSON, for digests."""
        return json.dumps(asdict(self), default=np.ndarray.tolist).encode()

    def to_json(self) -> dict[str, Any]:
        """Return the lamp as a JSON object."""
        return dict(json.loads(self.content))

    @staticmethod
    def from_json(node: Node) -> ActorLamp:
        """Return the lamp of `to_json`. Raises the node's error."""
        patches = tuple(
            LampPatch(
                patch.key("axis").integer(0), patch.key("side").integer(), patch.key("low").array(2),
                patch.key("texel_m").number(), patch.key("colours").array(2, -1, -1, 3).astype(np.float32),
                patch.key("share").array(-1, -1).astype(np.float32),
            )
            for patch in node.key("patches").elements()
        )  # fmt: skip
        times, shown = node.key("times_s").array(-1), node.key("shown").array(-1).astype(np.int64)
        states = tuple(state.text() for state in node.key("states").elements())
        sound = all(p.axis < 3 and p.texel_m > 0 and p.colours.shape[1:3] == p.share.shape for p in patches)
        if not (sound and len(times) == len(shown) > 0 and len(states) == 2 and np.isin(shown, (0, 1)).all()):
            node.fail("is no lamp")
        return ActorLamp(node.key("name").text(), states, times, shown, patches, node.key("certainty").number())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ActorLamp) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)
