"""Where two folders of outputs differ: byte by byte, and in numbers where a file holds some."""

from __future__ import annotations

import gzip
import io
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

NOT_COMPARED = ("timings.json", "training.jsonl", "checkpoint.safetensors")
"""Files that hold seconds."""
OF_THE_CODE = {
    "manifest.json": ("code.sha256", "inputs.key", "environment.kernels", "*.identity"),
    ".state/*.json": ("key", "*.identity"),
    "metrics.json": ("code.sha256",),
    "scene.json": ("training.seconds",),
}
"""Places in JSON files (`fnmatch`) that hold a digest or a version of the code, or seconds: each commit's and run's are its
own. A capture's identity has the code in it."""
KEYED_BY_CODE = ("surfel", "warp")
"""Renderers whose manifests have, as the scene's digest, a key of surfels, which has the code in it."""
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Part:
    """A part of a file that differs (a channel, an array, a place in a document), and how."""

    name: str
    how: str


@dataclass(frozen=True)
class Difference:
    """A file that differs, and its parts that do."""

    file: str
    parts: tuple[Part, ...]

    def __str__(self) -> str:
        more = f" and {len(self.parts) - 3} parts more" if len(self.parts) > 3 else ""
        return f"{self.file}: " + "; ".join(f"{part.name} {part.how}".strip() for part in self.parts[:3]) + more


@dataclass(frozen=True)
class Intended:
    """A difference that is meant: the commit that made it, why, and patterns (`fnmatch`) of a case, a file and a part of it."""

    commit: str
    reason: str
    case: str
    file: str
    part: str

    def covers(self, case: str, file: str, part: str) -> bool:
        """Whether it is this one."""
        return fnmatchcase(case, self.case) and fnmatchcase(file, self.file) and fnmatchcase(part, self.part)


def read_intended(path: Path) -> list[Intended]:
    """Read the commits that changed bytes on purpose, and each one's patterns. Raises ValueError, which names what is wrong."""
    found = []
    for row in json.loads(path.read_text()):
        if not _has(row, commit=str, reason=str, differences=list):
            raise ValueError(f'{path}: {row}: has to be "commit", "reason" and "differences", none of them empty')
        for pattern in row["differences"]:
            if not _has(pattern, case=str, file=str, part=str):
                raise ValueError(f'{path}: {pattern}: has to be "case", "file" and "part", none of them empty')
            found.append(Intended(row["commit"], row["reason"], **pattern))
    return found


def _has(row: Any, **kinds: type) -> bool:
    """Whether a JSON object has these members, of these types and not empty, and no other."""
    if not isinstance(row, dict) or row.keys() != kinds.keys():
        return False
    return all(isinstance(row[name], kind) and row[name] for name, kind in kinds.items())


def files_of(folder: Path) -> list[str]:
    """Files that are compared, as paths in the folder."""
    files = (path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file())
    return [file for file in files if Path(file).name not in NOT_COMPARED]


def differences(base: Path, head: Path) -> list[Difference]:
    """What differs between two folders' files; records and manifests, which tell of the others, come last."""
    found = []
    before, after = files_of(base), files_of(head)
    for file in sorted({*before, *after}, key=lambda name: (".state/" in name or name.endswith("manifest.json"), name)):
        if file not in before or file not in after:
            found.append(Difference(file, (Part("", f"is in {'head' if file in after else 'base'} alone"),)))
        elif parts := _parts(file, base / file, head / file):
            found.append(Difference(file, parts))
    return _without_digests(found)


def _without_digests(found: list[Difference]) -> list[Difference]:
    """The same without the digests that records and manifests have of files that differ: these are told already."""
    files = [f"/{difference.file}" for difference in found]

    def told(part: Part) -> bool:
        name = part.name.rpartition("files.")[2]
        return name != part.name and any(file.endswith(f"/{name}") for file in files)

    left = [Difference(d.file, tuple(part for part in d.parts if not told(part))) for d in found]
    return [difference for difference in left if difference.parts]


def _parts(file: str, a: Path, b: Path) -> tuple[Part, ...]:
    before, after = a.read_bytes(), b.read_bytes()
    if before == after:
        return ()
    suffix = a.suffix
    try:
        if suffix == ".json":
            return tuple(_json_parts(file, before, after))
        if suffix in READERS:
            arrays = READERS[suffix](before), READERS[suffix](after)
            _name_instances(*arrays)
            parts = tuple(_array_parts(*arrays))
            return parts or (Part("encoding", "differs, its numbers do not"),)
        if suffix == ".gz":
            before, after = gzip.decompress(before), gzip.decompress(after)
            if before == after:
                return (Part("compression", "differs, its content does not"),)
    except Exception as fault:  # a file that cannot be read any more is a difference, too
        return (Part("", f"cannot be read: {type(fault).__name__}: {fault}"),)
    first = next(
        (i for i, (x, y) in enumerate(zip(before, after, strict=False)) if x != y), min(len(before), len(after))
    )
    return (Part("", f"differs from byte {first} on ({len(before)} and {len(after)} bytes)"),)


def _name_instances(before: Arrays, after: Arrays) -> None:
    """Add which actor each value of the pass ``instance`` names, numbered alike in both: whatever else they name, the same one is
    to be there."""
    both = before, after
    if not all({"instance", "instances"} <= arrays.keys() for arrays in both):
        return
    numbers = {
        name: i + 1 for i, name in enumerate(sorted({str(name) for arrays in both for name in arrays["instances"]}))
    }
    for arrays in both:
        table = np.array([0, *(numbers[str(name)] for name in arrays["instances"])])
        arrays["instance by name"] = table[arrays["instance"].astype(np.int64)]


def _array_parts(before: Arrays, after: Arrays) -> Iterator[Part]:
    for name in [*before, *(name for name in after if name not in before)]:
        if name not in before or name not in after:
            yield Part(name, f"is in {'head' if name in after else 'base'} alone")
            continue
        a, b = before[name], after[name]
        texts = a.dtype.kind == b.dtype.kind == "U"  # their types have their lengths
        if a.shape != b.shape or (a.dtype != b.dtype and not texts):
            yield Part(name, f"is {a.dtype} {a.shape} in base, {b.dtype} {b.shape} in head")
        elif a.dtype != b.dtype or a.tobytes() != b.tobytes():
            yield Part(name, _how(a, b))


def _how(a: NDArray[Any], b: NDArray[Any]) -> str:
    """By how much two arrays differ."""
    if a.dtype.kind not in "biuf":
        return f"differs: {str(a)[:60]} and {str(b)[:60]}"
    bits = (np.frombuffer(x.tobytes(), np.uint8).reshape(x.size, x.dtype.itemsize) for x in (a, b))
    unlike = np.flatnonzero(np.not_equal(*bits).any(1))
    x, y = (array.reshape(-1)[unlike].astype(np.float64) for array in (a, b))
    with np.errstate(invalid="ignore"):
        apart = np.abs(x - y)
    finite = apart[np.isfinite(apart)]
    largest = f"by {finite.max():.3g} at most" if len(finite) else ""
    odd = "" if len(finite) == len(apart) else f"{len(apart) - len(finite)} are not finite in one"
    return f"differs in {len(unlike)} of {a.size} values {', '.join(filter(None, (largest, odd)))}"


def _json_parts(file: str, before: bytes, after: bytes) -> Iterator[Part]:
    own = [
        place for pattern, places in OF_THE_CODE.items() if fnmatchcase(f"/{file}", f"*/{pattern}") for place in places
    ]
    a, b = (dict(_leaves(json.loads(x))) for x in (before, after))
    if all(x.get("settings.renderer") in KEYED_BY_CODE for x in (a, b)):
        own.append("inputs.scenes.own")
    some = False
    for place in [*a, *(place for place in b if place not in a)]:
        x, y = a.get(place, "nothing"), b.get(place, "nothing")
        if (repr(x) != repr(y)) and not any(fnmatchcase(place, pattern) for pattern in own):
            some = True
            yield Part(place, _unlike(x, y))
    if not some and _shape(before, a, own) != _shape(after, b, own):
        yield Part("layout", "differs, its values do not")


def _unlike(x: Any, y: Any) -> str:
    if isinstance(x, int | float) and isinstance(y, int | float):
        return f"is {x!r} and {y!r}, apart by {abs(x - y):.3g}"
    return f"is {str(x)[:60]!r} and {str(y)[:60]!r}"


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value:
        for name, inner in value.items():
            yield from _leaves(inner, f"{place}.{name}" if place else name)
    elif isinstance(value, list) and value:
        for number, inner in enumerate(value):
            yield from _leaves(inner, f"{place}[{number}]")
    else:
        yield place, value


def _shape(data: bytes, leaves: dict[str, Any], own: list[str]) -> bytes:
    """A document's text without the values at places of its own."""
    for place in (one for one in leaves if any(fnmatchcase(one, pattern) for pattern in own)):
        name, value = (re.escape(json.dumps(x).encode()) for x in (place.rpartition(".")[2], leaves[place]))
        data = re.sub(name + rb"(\s*:\s*)" + value, rb"\1*", data)
    return data


def _png(data: bytes) -> Arrays:
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return {"pixels": np.asarray(image)}


def _exr(data: bytes) -> Arrays:
    import tempfile

    import OpenEXR

    with tempfile.NamedTemporaryFile(suffix=".exr") as file:
        file.write(data)
        file.flush()
        stored = OpenEXR.File(file.name, separate_channels=True)
        header = {name: value for name, value in stored.header().items() if name != "channels"}
        about = json.loads(header.pop("unisim", "{}"))
        head = {"instances": np.array(about.pop("instances", []), np.str_)}
        head |= {f"header {name}": np.array(repr(value)) for name, value in (*header.items(), *_leaves(about))}
        return {**{name: channel.pixels for name, channel in stored.channels().items()}, **head}


def _npz(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        return dict(stored)


def _ply(data: bytes) -> Arrays:
    from plyfile import PlyData

    stored = PlyData.read(io.BytesIO(data))
    columns = {name: element.data[name] for element in stored.elements for name in element.data.dtype.names}
    return {**columns, "comments": np.array("\n".join(stored.comments))}


def _safetensors(data: bytes) -> Arrays:
    size = int.from_bytes(data[:8], "little")
    head, body = json.loads(data[8 : 8 + size]), data[8 + size :]
    kinds = {
        "F64": "<f8",
        "F32": "<f4",
        "F16": "<f2",
        "I64": "<i8",
        "I32": "<i4",
        "I16": "<i2",
        "I8": "i1",
        "U8": "u1",
        "BOOL": "?",
    }
    arrays = {"metadata": np.array(json.dumps(head.pop("__metadata__", {})))}
    for name, about in head.items():
        begin, end = about["data_offsets"]
        arrays[name] = np.frombuffer(body[begin:end], kinds.get(about["dtype"], "u1"))
    return arrays


READERS: dict[str, Callable[[bytes], Arrays]] = {
    ".png": _png,
    ".jpg": _png,
    ".exr": _exr,
    ".npz": _npz,
    ".ply": _ply,
    ".safetensors": _safetensors,
}
"""How files of a kind become arrays; nothing is unpickled."""
