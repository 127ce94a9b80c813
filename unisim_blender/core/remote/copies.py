"""Copies of inputs that lie at URLs, in the user's cache folder: whole ones alone, by the digest of their content.

`inputs/copies/DIGEST/NAME` is a file or folder as it was fetched. `inputs/known/STAMP.json` says which digest a URL has whose
store lists these sizes and versions of its files, so that it is fetched once. A copy is made in a temporary folder beside them
and renamed. `limit.py` bounds the size of all. `inputs/` may be deleted while nothing runs.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import UnisimError
from ..files import CACHE_VARIABLE, cache_folder, sha256_of_file, write_file
from ..memo import memoized
from .limit import HAS_LOCKS, INPUTS, hold, make_room
from .requests import file_system, last_part, tried

THREADS = 8
"""Files that are fetched at a time."""
VERSIONS = (
    "ETag", "etag", "VersionId", "md5Hash", "generation", "content_md5", "Content-MD5", "LastModified",
    "last_modified", "Last-Modified", "updated", "mtime", "created",
)  # fmt: skip
"""Attributes of files in stores whose values differ once a file is written anew."""


class InputError(UnisimError):
    """An input that cannot be fetched."""


class MissingInput(InputError):
    """There is nothing at a URL."""


@dataclass(frozen=True)
class FolderPart:
    """A part of a folder's files. ``chosen`` returns the names of those that are fetched, given all files' sizes in bytes; the
    others stand as empty space of their size."""

    name: str
    chosen: Callable[[Mapping[str, int]], Collection[str]]


@dataclass(frozen=True)
class Copy:
    """The copy of what lies at a URL, or of a ``part`` of it, below ``root``, with the digest of its content. It pickles."""

    url: str
    part: FolderPart | None
    digest: str
    root: Path

    @property
    def key(self) -> tuple[str, str]:
        """The URL, and the name of the part, "" for all."""
        return self.url, _name(self.part)

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self.root / "copies" / self.digest / last_part(self.url)


_used: ContextVar[dict[tuple[str, str], Copy] | None] = ContextVar("used", default=None)


@contextmanager
def copies_used(known: Iterable[Copy] = ()) -> Iterator[dict[tuple[str, str], Copy]]:
    """Give the copies that `local_path` returns within it, by URL and part. Those ``known`` are taken as they are, also where
    something else lies at their URLs by now; one that is not on this machine is fetched where it was. Raises `InputError`."""
    used = {copy.key: copy for copy in known}
    for copy in used.values():
        if not _in_use(copy) and _fetched(copy.url, copy.part, copy.root).digest != copy.digest:
            raise InputError(f"{copy.url}: is not what it was when the batch was planned")
    token = _used.set(used)
    try:
        yield used
    finally:
        _used.reset(token)


def local_path(url: str, part: FolderPart | None = None) -> Path:
    """Return the path of the copy of a file or folder, which is fetched where there is none yet. Raises `InputError`, and
    `MissingInput` where nothing is at the URL."""
    url = url.rstrip("/")
    used = _used.get()
    for key in ((url, ""), (url, _name(part))):
        if used is not None and key in used:
            return used[key].path
    copy = _fetched(url, part, cache_folder() / INPUTS)
    if used is not None:
        used[copy.key] = copy
    return copy.path


def _name(part: FolderPart | None) -> str:
    return "" if part is None else part.name


@dataclass(frozen=True)
class _Listing:
    """The files at a URL by their names below it, "" for one file: their sizes, None where the store says none, and versions."""

    root: str
    sizes: dict[str, int | None]
    versions: dict[str, str]


@memoized
def _fetched(url: str, part: FolderPart | None, root: Path) -> Copy:
    fs, path = file_system(url, InputError)
    listing = _listed(url, fs, path)
    stamp = _stamp(url, _name(part), listing)
    known = root / "known" / f"{stamp}.json"
    with _alone(root, stamp):
        if stamp and (copy := _known_copy(url, part, root, known)) is not None and _in_use(copy):
            return copy
        copy, sizes = _fetch(url, part, root, fs, listing, stamp)
        if stamp:
            document = {"url": url, "part": _name(part), "digest": copy.digest, "sizes": sizes}
            write_file(known, (json.dumps(document, indent=1) + "\n").encode())
    return copy


def _in_use(copy: Copy) -> bool:
    """Have a copy stay while this process runs; whether it is there. Raises `InputError`."""
    with _writing_below(copy.root, copy.url):
        return hold(copy.root, copy.digest) and copy.path.exists()


@contextmanager
def _writing_below(root: Path, url: str) -> Iterator[None]:
    """Within it, a system that cannot write is an `InputError`."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{url}: cannot be kept below {root}: {error.strerror or error}; {CACHE_VARIABLE} names another folder"
        ) from error


def _listed(url: str, fs: Any, path: str) -> _Listing:
    def listed() -> dict[str, dict[str, Any]]:
        top = str(path).rstrip("/")
        try:
            if url.startswith(("http://", "https://")):  # what it would list are the links in a page
                return {"": fs.info(path)}
            entries = fs.find(path, detail=True)
            files = {name[len(top) :].lstrip("/"): entry for name, entry in entries.items() if not name.endswith("/")}
            return {"": fs.info(path)} if list(files) == [""] else files
        except FileNotFoundError:
            return {}

    files = tried(listed, f"{url}: cannot be listed", InputError)
    if not files:
        raise MissingInput(f"{url}: there is nothing there")
    for name in files:
        if ".." in name.split("/") or "\\" in name:
            raise InputError(f"{url}: holds {name!r}, which is no name of a file here")
    sizes = {name: None if info.get("size") is None else int(info["size"]) for name, info in files.items()}
    versions = {
        name: " ".join(f"{key}={info[key]}" for key in VERSIONS if info.get(key)) for name, info in files.items()
    }
    return _Listing(str(path).rstrip("/"), sizes, versions)


def _stamp(url: str, part: str, listing: _Listing) -> str:
    """Return what stands for the content at a URL; "" where its store does not tell versions apart."""
    if None in listing.sizes.values() or not all(listing.versions.values()):
        return ""
    rows = [[name, listing.sizes[name], listing.versions[name]] for name in sorted(listing.sizes)]
    return hashlib.sha256(json.dumps([url, part, rows]).encode()).hexdigest()[:40]


def _known_copy(url: str, part: FolderPart | None, root: Path, known: Path) -> Copy | None:
    """Return the copy that an earlier process made, if all its files have the sizes with which they were written."""
    try:
        document = json.loads(known.read_bytes())
        copy = Copy(url, part, str(document["digest"]), root)
        sizes = dict(document["sizes"])
        whole = _is_whole(copy, sizes)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return copy if whole and sizes else None


def _is_whole(copy: Copy, sizes: Mapping[str, int]) -> bool:
    """Return whether all files of a copy are there. Raises `OSError` where one is not."""
    return all((copy.path / name if name else copy.path).stat().st_size == size for name, size in sizes.items())


def _fetch(
    url: str, part: FolderPart | None, root: Path, fs: Any, listing: _Listing, stamp: str
) -> tuple[Copy, dict[str, int]]:
    """Fetch the files, and put them where their digest says; the copy, and its files' sizes."""
    sizes = {name: size for name, size in listing.sizes.items() if size is not None}
    chosen = set(listing.sizes) if part is None or len(sizes) < len(listing.sizes) else set(part.chosen(sizes))
    with _writing_below(root, url):
        make_room(root, sum(sizes.get(name, 0) for name in chosen))
        temporary = _temporary(root, stamp)
        try:
            top = temporary / last_part(url)

            def fetch(name: str) -> tuple[str, str, int]:
                local = top / name if name else top
                local.parent.mkdir(parents=True, exist_ok=True)
                size = listing.sizes[name]
                if name not in chosen:
                    with local.open("wb") as file:
                        file.truncate(size or 0)
                    return name, "", size or 0
                remote = f"{listing.root}/{name}" if name else listing.root
                shown = f"{url}/{name}" if name else url
                tried(lambda: _get(fs, remote, local, size), f"{shown}: cannot be fetched", InputError)
                return name, sha256_of_file(local), local.stat().st_size

            with ThreadPoolExecutor(THREADS) as pool:
                rows = sorted(pool.map(fetch, listing.sizes))
            again = _listed(url, fs, listing.root)
            if (again.sizes, again.versions) != (listing.sizes, listing.versions):
                raise InputError(f"{url}: was written while it was fetched; try again")
            about = json.dumps([last_part(url), rows])
            copy = Copy(url, part, hashlib.sha256(about.encode()).hexdigest()[:40], root)
            fetched = {name: size for name, _, size in rows}
            size = sum(size for name, size in fetched.items() if name in chosen)
            hold(root, copy.digest, lambda: _put(temporary, copy, fetched), size)
            return copy, fetched
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _temporary(root: Path, stamp: str) -> Path:
    """Return a new folder to fetch into; those that killed processes left of the same are removed."""
    (root / "copies").mkdir(parents=True, exist_ok=True)
    prefix = f".fetching-{stamp[:16]}-"
    for left in root.glob(f"{prefix}*") if stamp and HAS_LOCKS else ():
        shutil.rmtree(left, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=prefix, dir=root))


def _put(temporary: Path, copy: Copy, sizes: Mapping[str, int]) -> None:
    """Put a fetched copy in its place; a whole one that is there stays, a damaged one goes. Raises `OSError`."""
    place = copy.path.parent
    with suppress(OSError):
        if _is_whole(copy, sizes):
            return
    with suppress(FileNotFoundError):
        former = Path(tempfile.mkdtemp(prefix=".former-", dir=copy.root))
        try:
            place.rename(former / place.name)
        finally:
            shutil.rmtree(former, ignore_errors=True)
    temporary.rename(place)


def _get(fs: Any, remote: str, local: Path, size: int | None) -> None:
    """Fetch a file. Raises `OSError` where it is not as long as it was listed."""
    fs.get_file(remote, str(local))
    there = local.stat().st_size
    if size is not None and there != size:
        raise ConnectionError(f"{there} of {size} bytes came")


@contextmanager
def _alone(root: Path, stamp: str) -> Iterator[None]:
    """Have one process at a time fetch what has a stamp, where the system has locks of files; what a killed process left
    unfinished is removed."""
    if not stamp or not HAS_LOCKS:  # both fetch, and the first one's copy stays
        yield
        return
    import fcntl

    lock = root / "known" / f"{stamp}.lock"
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise InputError(
            f"{lock}: cannot be written: {error.strerror}; {CACHE_VARIABLE} names another folder"
        ) from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
