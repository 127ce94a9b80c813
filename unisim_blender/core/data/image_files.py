"""Image files of recorded drives and their headers. No image library is needed for JPEG and PNG.

An image's *size* is that of the upright image: EXIF's orientation tells how a stored one is turned to it (CIPA DC-008,
4.6.4).
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from ..errors import LogError, in_a_line, refused

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".jp2", ".avif")
"""Suffixes of files that are taken for images, in any case of letters; a layout's own suffix comes before these."""
KINDS = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG"}
MAX_SIDE = 1 << 15
PNG_BEGINS = b"\x89PNG\r\n\x1a\n"
UPRIGHT = 1
"""EXIF's orientation of an image that is stored upright."""
_ORIENTATION = 0x0112
_GREY, _RGB = 0, 2
CLEARLY = 0.05
"""Share of an image's side by which a principal point must be nearer to the middle to decide the calibrated
orientation."""


class Notes(dict[str, str]):
    """Notes for a log's user from reading it: one sentence a matter, the first one."""

    def say(self, matter: str, sentence: str) -> None:
        self.setdefault(matter, sentence)


@dataclass(frozen=True)
class ImageHeader:
    """An image file's width and height as stored, its orientation (1 to 8, as EXIF numbers them), bits of each channel,
    and whether its pixels are sRGB, or grey, of 8 bits each, and nothing else."""

    width: int
    height: int
    orientation: int = UPRIGHT
    bits: int = 8
    plain: bool = True

    @property
    def stored(self) -> tuple[int, int]:
        return self.width, self.height

    @property
    def upright(self) -> tuple[int, int]:
        """Width and height of the upright image."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)

    def size(self, cx: float, cy: float) -> tuple[int, int]:
        """Return the width and height that a camera was calibrated for whose principal point is cx, cy: the upright
        image's, unless the point is clearly nearer to the middle of the image as it is stored."""

        def off(size: tuple[int, int]) -> float:
            return max(abs(cx / size[0] - 0.5), abs(cy / size[1] - 0.5))

        return self.stored if off(self.stored) < off(self.upright) - CLEARLY else self.upright


def image_header(source: Path | bytes, where: str = "") -> ImageHeader:
    """Return the header of an image's file or of its bytes, which ``where`` names. Raises `LogError`."""
    where = where or str(source)
    with (
        refused(where, "read", LogError),
        io.BytesIO(source) if isinstance(source, bytes) else source.open("rb") as stream,
    ):
        begin = stream.read(8)
        if begin[:2] == b"\xff\xd8":
            stream.seek(2)
            header = _jpeg(stream, where)
        elif begin == PNG_BEGINS:
            header = _png(stream, where)
        else:
            header = _other(stream, source, where)
    if not (0 < header.width < MAX_SIDE and 0 < header.height < MAX_SIDE):
        raise LogError(f"{where}: has {header.width}x{header.height} pixels")
    return header


def files_by_stem(folder: Path, suffixes: Iterable[str], notes: Notes | None = None) -> dict[str, Path]:
    """Return the files of a folder that have one of some suffixes, in any case of letters, by their names without it,
    sorted. Of several of one stem the one with the first suffix is taken, and noted. Empty where there is no folder;
    raises `LogError` where it cannot be read."""
    order = {suffix: rank for rank, suffix in reversed(list(enumerate(suffixes)))}
    with refused(folder, "read", LogError):
        paths = sorted(folder.iterdir()) if folder.is_dir() else []
    by_stem: dict[str, tuple[int, Path]] = {}
    for path in paths:
        name = path.name.lower()
        suffix = next((suffix for suffix in order if name.endswith(suffix)), None)
        if suffix is None:
            continue
        stem, here = path.name[: -len(suffix)], (order[suffix], path)
        taken, other = sorted((by_stem.setdefault(stem, here), here))
        if taken is not other and notes is not None:
            notes.say(f"twice {folder}", f"{taken[1]}: is read, and {other[1].name} beside it is not")
        by_stem[stem] = taken
    return {stem: path for stem, (_, path) in by_stem.items()}


def image_suffixes(own: str) -> tuple[str, ...]:
    """Return the suffixes of images, the layout's ``own`` first."""
    return (own, *(suffix for suffix in SUFFIXES if suffix != own))


def what_else(folder: Path) -> str:
    """Return a remark on the files of a folder in which none is an image, " (but 20 files .npy)"; "" where it is
    empty."""
    try:
        suffixes = Counter(path.suffix for path in folder.iterdir() if path.is_file() and path.suffix != ".txt")
    except OSError:
        return ""
    suffixes.pop(".json", None)
    return "".join(f" (but {count} files {suffix or 'without suffix'})" for suffix, count in suffixes.most_common(1))


def _jpeg(stream: BinaryIO, where: str) -> ImageHeader:
    """Return the header by the first frame header (ITU-T T.81, annex B); the stream is after the file's first
    marker."""
    orientation, plain = UPRIGHT, True
    while True:
        marker = stream.read(2)
        while len(marker) == 2 and marker[0] == 0xFF and marker[1] == 0xFF:
            marker = marker[1:] + stream.read(1)
        if len(marker) < 2 or marker[0] != 0xFF:
            raise LogError(f"{where}: is a broken JPEG image")
        length = int.from_bytes(stream.read(2), "big") - 2
        if length < 0:
            raise LogError(f"{where}: is a broken JPEG image")
        segment = stream.read(length)
        if marker[1] == 0xE1 and segment.startswith(b"Exif\0\0"):
            orientation = _orientation(segment[6:])
        elif marker[1] == 0xE2 and segment.startswith((b"ICC_PROFILE\0", b"MPF\0")):
            plain = False
        elif 0xC0 <= marker[1] <= 0xCF and marker[1] not in (0xC4, 0xC8, 0xCC) and len(segment) >= 6:
            height, width = int.from_bytes(segment[1:3], "big"), int.from_bytes(segment[3:5], "big")
            usual = segment[0] == 8 and segment[5] in (1, 3) and orientation == UPRIGHT
            return ImageHeader(width, height, orientation, segment[0], plain and usual)


def _png(stream: BinaryIO, where: str) -> ImageHeader:
    """Return the header by the chunks before the pixels (PNG, third edition, 11); the stream is after the signature."""
    head = stream.read(16)
    if len(head) < 16 or head[4:8] != b"IHDR":
        raise LogError(f"{where}: is no PNG image")
    width, height = int.from_bytes(head[8:12], "big"), int.from_bytes(head[12:16], "big")
    bits, colour = (*stream.read(2), 8, _RGB)[:2]
    stream.read(7)  # how it is packed, and the chunk's check
    orientation, plain = UPRIGHT, bits == 8 and colour in (_GREY, _RGB)
    while len(chunk := stream.read(8)) == 8 and chunk[4:] not in (b"IDAT", b"IEND"):
        length = int.from_bytes(chunk[:4], "big")
        if chunk[4:] == b"eXIf":
            orientation = _orientation(stream.read(length))
            stream.seek(4, io.SEEK_CUR)
        else:
            stream.seek(length + 4, io.SEEK_CUR)
        plain = plain and chunk[4:] not in (b"iCCP", b"gAMA", b"tRNS", b"acTL", b"cHRM", b"cICP")
    return ImageHeader(width, height, orientation, bits, plain and orientation == UPRIGHT)


def _orientation(exif: bytes) -> int:
    """Return the orientation of EXIF data, from the first directory of its TIFF; upright where it has none, or an
    unknown one."""
    orders: dict[bytes, Literal["little", "big"]] = {b"II": "little", b"MM": "big"}
    order = orders.get(exif[:2])
    if order is None:
        return UPRIGHT

    def number(at: int, size: int) -> int:
        return int.from_bytes(exif[at : at + size], order)

    at = number(4, 4)
    for entry in range(at + 2, min(at + 2 + 12 * number(at, 2), len(exif) - 11), 12):
        if number(entry, 2) == _ORIENTATION:
            value = number(entry + 8, 2)
            return value if 1 <= value <= 8 else UPRIGHT
    return UPRIGHT


def _other(stream: BinaryIO, source: Path | bytes, where: str) -> ImageHeader:
    """Return the header of another kind of image, by Pillow."""
    kind = "" if isinstance(source, bytes) else KINDS.get(source.suffix.lower(), "")
    try:
        from PIL import Image, UnidentifiedImageError
    except ModuleNotFoundError as error:
        raise LogError(f"{where}: is no JPEG or PNG image, and Pillow, which reads others, is missing") from error
    try:
        stream.seek(0)
        with Image.open(stream) as image:
            deep = image.mode.startswith("I") or image.mode == "F"
            # Pillow turns TIFF itself
            orientation = UPRIGHT if image.format == "TIFF" else image.getexif().get(_ORIENTATION, UPRIGHT)
            orientation = orientation if orientation in range(1, 9) else UPRIGHT
            return ImageHeader(image.width, image.height, orientation, 16 if deep else 8, plain=False)
    except UnidentifiedImageError as error:
        raise LogError(f"{where}: is no {kind} image" if kind else f"{where}: is no image") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise LogError(f"{where}: is a broken image ({in_a_line(error)})") from error
