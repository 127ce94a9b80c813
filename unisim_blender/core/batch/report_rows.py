"""The rows of a batch's report: a variant each, of what the manifest and the failures say."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .records import scenario_name

SCORES = {
    "collisions": "collision.count",
    "at fault": "collision.at_fault_count",
    "first at, s": "collision.first_s",
    "least TTC, s": "time_to_collision.minimum_s",
    "PDMS": "pdms.score",
    "HD-score": "hd_score.score",
    "AlpaSim score": "alpasim_score.score",
    "NCAP stars": "ncap.stars",
    "progress": "progress.share",
    "off the log, m": "deviation.across_max_m",
    "off road": "off_road.off_road",
    "comfortable": "comfort.comfortable",
}
"""Columns of scores, and where a rollout's scores have them."""
FINISHED, FAILED, UNFINISHED = "finished", "failed", "unfinished"
SHOWN = 3
"""Largest number of a variant's images that are shown."""
_IMAGE = re.compile(r"(?:^|/)camera/[^/]+/[^/]+\.png$")


@dataclass(frozen=True)
class VariantRow:
    """A variant: its ``state``, values of parameters and scores by column, names of the images that show it, and the command
    that repeats it."""

    name: str
    state: str
    parameters: Mapping[str, Any]
    scores: Mapping[str, Any]
    repeat: Sequence[str] = ()
    images: Sequence[str] = field(default_factory=tuple)
    place: str = ""
    """The object, or the beginning of those, that has more."""

    @property
    def collided(self) -> bool:
        """Whether the ego vehicle hit something."""
        return bool(self.scores.get("collisions"))


def rows_of(manifest: Mapping[str, Any], failures: Sequence[Mapping[str, Any]]) -> list[VariantRow]:
    """Return a row for each variant of a batch's manifest, in its order. ``failures`` are those of its units.

    A variant has failed where a unit of it has, and is unfinished where captures of it, or its rollout, are missing.
    """
    failed = {one.get("variant") for one in failures}
    used = _uses(manifest)
    rows = []
    for name, variant in manifest["variants"].items():
        rollout = variant.get("rollout")
        images = _images_of_rollout(rollout) if rollout else _images_of_moments(variant, manifest["captures"], used)
        if name in failed:
            state = FAILED
        else:
            state = FINISHED if _is_whole(variant, manifest["captures"]) else UNFINISHED
        place = f"rollouts/{name}/" if rollout else scenario_name(name)
        scores = {} if rollout is None else _scores(rollout.get("scores") or {})
        parameters = {**variant.get("parameters", {}), **_seed(variant)}
        rows.append(VariantRow(name, state, parameters, scores, variant.get("repeat", ()), images, place))
    return rows


def _seed(variant: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a rollout has been asked for besides: which driver, and a seed of its own."""
    return {name: variant[name] for name in ("driver", "seed") if variant.get(name) is not None}


def _is_whole(variant: Mapping[str, Any], captures: Mapping[str, Any]) -> bool:
    if "moments" not in variant:
        return "rollout" in variant
    return all(identity in captures for moment in variant["moments"].values() for identity in moment.values())


def _scores(scores: Mapping[str, Any]) -> dict[str, Any]:
    found = {}
    for title, path in SCORES.items():
        value: Any = scores
        for member in path.split("."):
            value = value.get(member) if isinstance(value, Mapping) else None
        if isinstance(value, int | float):
            found[title] = value
    return found


def _uses(manifest: Mapping[str, Any]) -> dict[str, int]:
    """Return how many variants refer to each capture."""
    found: dict[str, int] = {}
    for variant in manifest["variants"].values():
        for identity in {one for moment in variant.get("moments", {}).values() for one in moment.values()}:
            found[identity] = found.get(identity, 0) + 1
    return found


def _images_of_rollout(rollout: Mapping[str, Any]) -> list[str]:
    """Return images of the first camera: the first and the last, and that of the first contact or the middle."""
    images = _of_one_camera([name for name in rollout["files"] if _IMAGE.search(name)])
    if len(images) <= SHOWN:
        return images
    hit_s = ((rollout.get("scores") or {}).get("collision") or {}).get("first_s")
    if isinstance(hit_s, int | float):
        after = [name for name in images[1:-1] if _seconds(name) >= hit_s]
        middle = after[0] if after else images[-2]
    else:
        middle = images[len(images) // 2]
    return [images[0], middle, images[-1]]


def _images_of_moments(variant: Mapping[str, Any], captures: Mapping[str, Any], used: Mapping[str, int]) -> list[str]:
    """Return images of the first camera that as few other variants as possible share, spread over the moments."""
    found: list[tuple[str, int]] = []
    for moment in variant.get("moments", {}).values():
        for identity in (one for name, one in moment.items() if name.startswith("camera/")):
            found += [(name, used[identity]) for name in captures.get(identity, {}).get("files", ())]
    images = [(name, uses) for name, uses in found if _IMAGE.search(name)]
    names = set(_of_one_camera([name for name, _ in images]))
    images = [(name, uses) for name, uses in images if name in names]
    fewest = min((uses for _, uses in images), default=0)
    rare = [name for name, uses in images if uses == fewest]
    if len(rare) <= SHOWN:
        return rare
    return [rare[0], rare[len(rare) // 2], rare[-1]]


def _of_one_camera(names: Sequence[str]) -> list[str]:
    cameras = [name.split("/")[-2] for name in names]
    return [name for name, camera in zip(names, cameras, strict=True) if camera == cameras[0]]


def _seconds(name: str) -> float:
    """Return the time of an image of a rollout, from its name; before all where that says none."""
    found = re.search(r"/t(-?\d+)us\.png$", name)
    return int(found[1]) / 1e6 if found else float("-inf")
