"""The report of a batch, read off its store alone: one page of HTML with its variants, their images and scores.

A script without a network filters and sorts its table; without scripts it is a table.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image, UnidentifiedImageError

from ..errors import OutputError
from .manifest import MANIFEST_NAME
from .records import Store, read_failures, scenario_name

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
    "invalid steps": "validity.invalid_steps",
    "valid until, s": "validity.valid_until_s",
    "PDMS, valid part": "valid_part.pdms.score",
    "collisions, valid part": "valid_part.collision.count",
}
"""Columns of scores, and where a rollout's scores have them."""
FINISHED, FAILED, UNFINISHED = "finished", "failed", "unfinished"
MAX_IMAGES_SHOWN = 3
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
    failed = {failure.get("variant") for failure in failures}
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
    by_title = {}
    for title, path in SCORES.items():
        value: Any = scores
        for member in path.split("."):
            value = value.get(member) if isinstance(value, Mapping) else None
        if isinstance(value, int | float):
            by_title[title] = value
    return by_title


def _uses(manifest: Mapping[str, Any]) -> dict[str, int]:
    """Return how many variants refer to each capture."""
    uses: dict[str, int] = {}
    for variant in manifest["variants"].values():
        for identity in {digest for moment in variant.get("moments", {}).values() for digest in moment.values()}:
            uses[identity] = uses.get(identity, 0) + 1
    return uses


def _images_of_rollout(rollout: Mapping[str, Any]) -> list[str]:
    """Return images of the first camera: the first and the last, and that of the first contact or the middle."""
    images = _of_first_camera([name for name in rollout["files"] if _IMAGE.search(name)])
    if len(images) <= MAX_IMAGES_SHOWN:
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
    files: list[tuple[str, int]] = []
    for moment in variant.get("moments", {}).values():
        for identity in (digest for name, digest in moment.items() if name.startswith("camera/")):
            files += [(name, used[identity]) for name in captures.get(identity, {}).get("files", ())]
    images = [(name, uses) for name, uses in files if _IMAGE.search(name)]
    names = set(_of_first_camera([name for name, _ in images]))
    images = [(name, uses) for name, uses in images if name in names]
    fewest = min((uses for _, uses in images), default=0)
    rare = [name for name, uses in images if uses == fewest]
    if len(rare) <= MAX_IMAGES_SHOWN:
        return rare
    return [rare[0], rare[len(rare) // 2], rare[-1]]


def _of_first_camera(names: Sequence[str]) -> list[str]:
    cameras = [name.split("/")[-2] for name in names]
    return [name for name, camera in zip(names, cameras, strict=True) if camera == cameras[0]]


def _seconds(name: str) -> float:
    """Return the time of an image of a rollout, from its name; before all where that says none."""
    match = re.search(r"/t(-?\d+)us\.png$", name)
    return int(match[1]) / 1e6 if match else float("-inf")


REPORT_NAME = "report.html"
COUNTS = ("asked", "rendered", "shared")
THUMBNAIL_PX = 128, 72
"""The most pixels of one of them, in width and in height."""
JPEG_QUALITY = 70
MAX_THUMBNAILS = 2000
"""Variants with thumbnails; a page with more of them would open slowly."""
READER_THREADS = 8


def batch_report(store: Store, beside: bool = True) -> bytes:
    """Return the report of a batch as HTML: a function of what the store holds.

    ``beside`` says whether it will lie in the store; else it names objects by their whole paths or URLs. Raises `OutputError`
    where the store has no manifest, which every run of a batch writes at its end.
    """
    data = store.read(MANIFEST_NAME)
    if data is None:
        raise OutputError(
            f"{store.where(MANIFEST_NAME)}: is not written yet: the batch runs, or continues with --resume"
        )
    try:
        manifest = json.loads(data)
        failures = read_failures(store)
        rows = rows_of(manifest, failures)
        title = _title(manifest)
        images = thumbnails(store, [row.images for row in rows])
        place = "" if beside and store.folder is not None else store.where("")
        place = place if not place or place.endswith("/") else f"{place}/"
        return report_page(title, manifest["counts"], rows, failures, images, place).encode()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OutputError(f"{store.where(MANIFEST_NAME)}: is none of a batch") from error


def write_report(store: Store) -> None:
    """Write the report into the store. Raises `OutputError`."""
    store.write(REPORT_NAME, batch_report(store))


def _title(manifest: dict[str, Any]) -> str:
    """Return the names of the scenarios, or how many there are."""
    names = list(dict.fromkeys(variant["scenario"]["name"] for variant in manifest["variants"].values()))
    return ", ".join(names) if len(names) <= 3 else f"{len(names)} scenarios"


def report_page(
    title: str,
    counts: Mapping[str, int],
    rows: Sequence[VariantRow],
    failures: Sequence[Mapping[str, Any]],
    images: Sequence[str],
    place: str = "",
) -> str:
    """Return the page. ``images`` are data URIs, one for each row.

    ``place`` goes before names of objects: "" for a page that lies beside them, or a folder or URL that ends with a slash.
    All text is escaped, and the page's policy lets no other script run than its own.
    """
    script, style = _text("report.js"), _text("report.css")
    policy = f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src '{_digest(script)}'"
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{policy}">'
        f'<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{style}</style>"
    )
    body = [f"<h1>{escape(title)}</h1>", _summary(counts, rows), *_failures(failures), *_table(rows, images, place)]
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n'
        + "\n".join(body)
        + f"\n<script>{script}</script>\n</body></html>\n"
    )


def _summary(counts: Mapping[str, int], rows: Sequence[VariantRow]) -> str:
    states = [row.state for row in rows]
    parts = [f"{len(rows)} variants"]
    parts += [f"{states.count(name)} {name}" for name in (FINISHED, FAILED, UNFINISHED) if name in states]
    driven = [row for row in rows if row.scores]
    if driven:
        parts.append(f"{sum(row.collided for row in driven)} with a collision")
    measured = [row for row in driven if "invalid steps" in row.scores]
    if measured:
        valid = [row for row in measured if not row.scores["invalid steps"]]
        parts.append(f"{len(valid)} valid throughout, {sum(row.collided for row in valid)} of these with a collision")
    captures = ""
    if counts.get("asked"):
        asked, rendered, shared = (counts.get(name, 0) for name in COUNTS)
        captures = f"<p>{asked} captures asked for, {rendered} rendered, {shared} shared by variants.</p>"
    return f"<p>{', '.join(parts)}; {counts.get('units', 0)} units.</p>{captures}"


def _failures(failures: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    if not failures:
        return
    heads = "".join(f"<th>{title}</th>" for title in ("unit", "variant", "why", "repeat it"))
    yield f'<h2>Failed units</h2><table id="failures"><thead><tr>{heads}'
    yield "</tr></thead><tbody>"
    for failure in failures:
        unit, variant, reason, command = (
            str(failure.get(name, "")) for name in ("unit", "variant", "reason", "command")
        )
        cells = f"<td>{escape(unit)}</td><td>{escape(variant)}</td><td>{escape(reason)}</td>"
        yield f"<tr>{cells}<td><code>{escape(command)}</code></td></tr>"
    yield "</tbody></table>"


def _table(rows: Sequence[VariantRow], images: Sequence[str], place: str) -> Iterable[str]:
    parameters = list(dict.fromkeys(name for row in rows for name in row.parameters))
    scores = [title for title in SCORES if any(title in row.scores for row in rows)]
    heads = [
        '<th data-kind="none">images</th>',
        _head("variant", "text"),
        *(_head(name, _kind(row.parameters.get(name) for row in rows), "parameter") for name in parameters),
        _head("state", "text"),
        *(_head(title, _kind(row.scores.get(title) for row in rows), "score") for title in scores),
    ]
    where = "in the folder of this page" if not place else "anywhere"
    yield f'<h2>Variants</h2><div id="map" hidden></div><p id="shown">Commands that repeat a variant hold {where}.</p>'
    yield f'<table id="variants"><thead><tr>{"".join(heads)}</tr></thead><tbody>'
    for row, image in zip(rows, images, strict=True):
        yield _row(row, image, parameters, scores, place)
    yield "</tbody></table>"


def _row(row: VariantRow, image: str, parameters: Sequence[str], scores: Sequence[str], place: str) -> str:
    link = escape(_link(place, row.place))
    shown = f'<img alt="" src="{escape(image)}">' if image else ""
    cells = [
        f"<td>{shown}</td>",
        f'<td data-value="{_value(row.name)}"><a href="{link}">{escape(row.name)}</a>{_command(row, place)}</td>',
        *(_cell(row.parameters.get(name)) for name in parameters),
        _cell(row.state),
        *(_cell(row.scores.get(title)) for title in scores),
    ]
    bad = ' class="bad"' if row.collided or row.state == FAILED else ""
    return f"<tr{bad}>{''.join(cells)}</tr>"


def _command(row: VariantRow, place: str) -> str:
    """Return the command line; the object of the scenario is its second word."""
    if not row.repeat:
        return ""
    command, scenario, *options = row.repeat
    line = shlex.join(["unisim", command, place + scenario, *options, "--out", f"repeat-{row.name}"])
    return f"<details><summary>repeat it</summary><code>{escape(line)}</code></details>"


def _head(title: str, kind: str, role: str = "") -> str:
    return f'<th data-kind="{kind}" data-role="{role}">{escape(title)}</th>'


def _kind(values: Iterable[Any]) -> str:
    there = [value for value in values if value is not None]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in there)
    return "number" if there and numbers else "text"


def _cell(value: Any) -> str:
    if value is None:
        return "<td></td>"
    if isinstance(value, bool):
        text = "yes" if value else "no"
        return f'<td data-value="{_value(text)}">{text}</td>'
    if isinstance(value, float):
        text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    else:
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    kind = ' class="number"' if isinstance(value, int | float) else ""
    return (
        f'<td{kind} data-value="{_value(value if isinstance(value, int | float | str) else text)}">{escape(text)}</td>'
    )


def _value(value: Any) -> str:
    return escape(json.dumps(value))


def _link(place: str, name: str) -> str:
    """Return a link's target: of an object beside the page, of a file, or the object's URL as it is."""
    if not place:
        return quote(name)
    if "://" in place:
        return place + name
    return Path(place + name).absolute().as_uri() + ("/" if name.endswith("/") else "")


@cache
def _text(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    """Return a script's or style's digest as a content security policy has it."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def thumbnails(store: Store, images: Sequence[Sequence[str]]) -> list[str]:
    """Return for each variant its images side by side as a JPEG's data URI; "" where it has none that can be read.

    ``images`` are names of objects. Variants after the first `MAX_THUMBNAILS` have none. Raises `OutputError`.
    """
    with ThreadPoolExecutor(READER_THREADS) as pool:
        thumbnails = list(pool.map(lambda names: _strip(store, names), images[:MAX_THUMBNAILS]))
    return thumbnails + [""] * (len(images) - len(thumbnails))


def _strip(store: Store, names: Sequence[str]) -> str:
    small = [image for name in names if (image := _small(store.read(name))) is not None]
    if not small:
        return ""
    strip = Image.new("RGB", (sum(image.width for image in small), max(image.height for image in small)))
    left = 0
    for image in small:
        strip.paste(image, (left, 0))
        left += image.width
    file = io.BytesIO()
    strip.save(file, "JPEG", quality=JPEG_QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def _small(data: bytes | None) -> Image.Image | None:
    if data is None:
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            small = image.convert("RGB")
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError):
        return None  # it is damaged: the batch says so where it resumes
    small.thumbnail(THUMBNAIL_PX, Image.Resampling.BOX)
    return small
