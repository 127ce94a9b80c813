"""Lamps of actors that a log shows in two states: which it shows when, and how the lamp's part of the box looks in each."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, bilinear
from ..json_file import Node


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
        safe = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
        enter = (-np.sign(safe) * size_m / 2 - origins) / safe
        entered = (enter.argmax(1) == self.axis) & (np.sign(safe[:, self.axis]) == -self.side)
        point = origins + enter.max(1)[:, None] * directions
        at = (np.delete(point, self.axis, 1) - self.low) / self.texel_m - 0.5
        padded = np.zeros((self.share.shape[0] + 2, self.share.shape[1] + 2, 4), np.float32)
        padded[1:-1, 1:-1, 3:] = self.share[..., None]
        padded[1:-1, 1:-1, :3] = self.colours[state] * self.share[..., None]
        value = bilinear(padded, at[:, 1] + 1.5, at[:, 0] + 1.5)
        share = value[:, 3:] * entered[:, None]
        return value[:, :3] / np.maximum(value[:, 3:], 1e-6), share


@dataclass(frozen=True, eq=False)
class ActorLamp:
    """A lamp of an actor, or several that change together. ``name`` is its colour, and the side that it is on: "red", "amber
    left"; of two that alternate both colours: "red-green".

    ``states`` are "off" and "on", or the colours that are lit. From ``times_s`` (K,), seconds, on it shows state ``shown`` (K,),
    and the first before, too. ``certainty``: mean probability of the states that were recognised in a log's images.
    """

    name: str
    states: tuple[str, str]
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
        after = self.at(to_s).shown
        before, later = self.times_s < from_s, self.times_s > to_s
        times = np.concatenate([self.times_s[before], [from_s, to_s], self.times_s[later]])
        shown = [*self.shown[before], self.states.index(state), *after, *self.shown[later]]
        if not before.any() and np.isfinite(from_s):
            times, shown = np.concatenate([[-np.inf], times]), [self.shown[0], *shown]
        return replace(self, times_s=times, shown=np.array(shown, np.int64))

    def to_json(self) -> dict[str, Any]:
        """Return the lamp as a JSON object."""
        patches = [
            {
                "axis": patch.axis, "side": patch.side, "low": patch.low.tolist(), "texel_m": patch.texel_m,
                "shape": list(patch.share.shape), "colours": patch.colours.tolist(), "share": patch.share.tolist(),
            }
            for patch in self.patches
        ]  # fmt: skip
        shown = {"times_s": self.times_s.tolist(), "shown": self.shown.tolist()}
        return {
            "name": self.name,
            "states": list(self.states),
            **shown,
            "patches": patches,
            "certainty": self.certainty,
        }

    @staticmethod
    def from_json(node: Node) -> ActorLamp:
        """Return the lamp of `to_json`. Raises the node's error."""
        off, on = (state.text() for state in node.key("states").elements())
        times = node.key("times_s").array(-1)
        shown = node.key("shown").array(len(times)).astype(np.int64)
        patches = []
        for patch in node.key("patches").elements():
            height, width = (size.integer(1) for size in patch.key("shape").elements())
            colours = patch.key("colours").array(2, height, width, 3).astype(np.float32)
            share = patch.key("share").array(height, width).astype(np.float32)
            axis, side, texel_m = (
                patch.key("axis").integer(0),
                patch.key("side").integer(),
                patch.key("texel_m").number(),
            )
            patches.append(LampPatch(axis, side, patch.key("low").array(2), texel_m, colours, share))
        if not len(times) or not np.isin(shown, (0, 1)).all() or not all(p.axis < 3 and p.texel_m > 0 for p in patches):
            node.fail("is no lamp")
        return ActorLamp(
            node.key("name").text(), (off, on), times, shown, tuple(patches), node.key("certainty").number()
        )  # fmt: skip

    @cached_property
    def content(self) -> bytes:
        """All of it as bytes, for digests."""
        return json.dumps(self.to_json()).encode()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ActorLamp) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)
