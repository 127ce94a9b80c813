"""Pixels of recorded images, as every reader takes them: of any kind of file, turned and scaled as its header says."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.data.image_files import Notes, image_header
from unisim_blender.core.data.images import read_image, rgb_pixels
from unisim_blender.core.errors import LogError

V, U = np.mgrid[:24, :36]
RGB = np.stack([U * 7, V * 10, (U + V) * 4], -1).astype(np.uint8)
"""Smooth, and no two of its corners are alike."""
GREY = RGB[..., 1]
ORIENTATION = 0x0112
TO_STORED = {
    1: None,
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
"""What takes an upright image to one that is stored with an orientation (CIPA DC-008, 4.6.4)."""


def packed(image: Image.Image, kind: str, **options: Any) -> bytes:
    """An image's file."""
    file = io.BytesIO()
    image.save(file, kind, **options)
    return file.getvalue()


def read(content: bytes, size: tuple[int, int] = (36, 24)) -> tuple[NDArray[np.uint8], str]:
    """The pixels of an image's file, and what was noted."""
    notes = Notes()
    pixels = read_image(content, size, "the camera is another", notes, "front", "a.img")
    return pixels, "\n".join(notes.values())


@pytest.mark.parametrize("mode", ["RGB", "L", "P", "RGBA", "CMYK", "1"])
@pytest.mark.parametrize("height", [1, 31, 32, 75])
def test_pixels_are_those_that_pillow_gives(mode: str, height: int) -> None:
    rgb = np.random.default_rng(height).integers(0, 256, (height, 45, 3), np.uint8)
    image = Image.fromarray(rgb).convert(mode)
    np.testing.assert_array_equal(rgb_pixels(image), np.asarray(image.convert("RGB")))
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "PNG")
    with Image.open(file) as image:
        np.testing.assert_array_equal(rgb_pixels(image), rgb)


def test_a_file_that_is_cut_off_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "cut.jpg"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (200, 300, 3), np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:-20000])
    with Image.open(path) as image, pytest.raises(OSError, match="truncated"):
        rgb_pixels(image)
    with pytest.raises(LogError, match="cut.jpg: cannot be decoded"):
        read_image(path, (300, 200), "", Notes(), "front")


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "WEBP", "BMP", "JPEG2000"])
def test_kinds_without_loss(kind: str) -> None:
    options = {"lossless": True} if kind == "WEBP" else {"irreversible": False} if kind == "JPEG2000" else {}
    pixels, notes = read(packed(Image.fromarray(RGB), kind, **options))
    np.testing.assert_array_equal(pixels, RGB)
    assert not notes


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
@pytest.mark.parametrize("of", [257, 256])
def test_grey_of_16_bits_is_scaled(kind: str, of: int) -> None:
    """By 257, so that white stays white; made by a shift of 8 bits, it is within 1."""
    pixels, notes = read(packed(Image.fromarray(GREY.astype(np.uint16) * of), kind))
    assert np.abs(pixels - GREY[..., None].astype(int)).max() <= (0 if of == 257 else 1)
    assert not notes


def test_12_bits_in_16_are_a_doubt() -> None:
    pixels, notes = read(packed(Image.fromarray(GREY.astype(np.uint16) * 16), "PNG"))
    assert pixels.max() < 16 and notes.startswith("a.img: has 16 bits a channel, of which its brightest pixel fills ")


@pytest.mark.parametrize(("dtype", "what"), [(np.float32, "32-bit floats"), (np.int32, "32-bit whole numbers")])
def test_numbers_of_no_stated_range_are_refused(dtype: Any, what: str) -> None:
    with pytest.raises(LogError, match=f"a.img: holds {what} from 0 to 230, not colours"):
        read(packed(Image.fromarray(GREY.astype(dtype)), "TIFF"))


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_transparency_is_noted_and_opaque_images_are_not(mode: str) -> None:
    image = Image.fromarray(RGB).convert({"P": "RGB"}.get(mode, mode)).convert(mode)
    opaque, notes = read(packed(image, "PNG"))
    assert not notes
    if mode == "P":
        content = packed(image, "PNG", transparency=image.getpixel((0, 0)))
    else:
        image.putalpha(Image.fromarray(np.where(V < 6, 0, 255).astype(np.uint8)))
        content = packed(image, "PNG")
    pixels, notes = read(content)
    np.testing.assert_array_equal(pixels, opaque)
    assert notes.startswith("a.img: is transparent in ") and "of its pixels" in notes


@pytest.mark.parametrize("kind", ["GIF", "PNG", "WEBP", "TIFF"])
def test_of_several_images_in_a_file_the_first_is_read(kind: str) -> None:
    first, second = Image.fromarray(GREY), Image.fromarray(255 - GREY)
    options = {"lossless": True} if kind == "WEBP" else {}
    pixels, notes = read(packed(first, kind, save_all=True, append_images=[second], **options))
    np.testing.assert_array_equal(pixels[..., 0], GREY)
    assert notes == "a.img: holds 2 images, of which the first is read"


def test_another_gamma_is_a_doubt() -> None:
    def with_gamma(value: int) -> bytes:
        content = packed(Image.fromarray(RGB), "PNG")
        chunk = b"gAMA" + struct.pack(">I", value)
        import zlib

        return content[:33] + struct.pack(">I", 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[33:]

    assert read(with_gamma(45455))[1] == ""
    assert read(with_gamma(100000))[1].startswith("a.img: states a gamma of 1, not sRGB's")


def profile(red: tuple[float, ...], green: tuple[float, ...], blue: tuple[float, ...], name: bytes) -> bytes:
    """An ICC profile (ICC.1:2001-04) of three primaries, XYZ, and a gamma of 2.2."""

    def s15(values: tuple[float, ...]) -> bytes:
        return b"XYZ \0\0\0\0" + b"".join(struct.pack(">i", round(value * 65536)) for value in values)

    text = b"desc\0\0\0\0" + struct.pack(">I", len(name) + 1) + name + b"\0" + bytes(78)
    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(2.2 * 256)) + b"\0\0"
    white = (0.9642, 1.0, 0.8249)
    tags = {b"desc": text, b"cprt": b"text\0\0\0\0none\0", b"wtpt": s15(white), b"rXYZ": s15(red), b"gXYZ": s15(green)}
    tags |= {b"bXYZ": s15(blue), b"rTRC": curve, b"gTRC": curve, b"bTRC": curve}
    table, data = struct.pack(">I", len(tags)), b""
    begin = 128 + 4 + 12 * len(tags)
    for key, value in tags.items():
        table += key + struct.pack(">II", begin + len(data), len(value))
        data += value + bytes(-len(value) % 4)
    head = bytes(4) + b"lcms" + bytes.fromhex("02100000") + b"mntrRGB XYZ " + bytes(12) + b"acsp" + bytes(28)
    head += b"".join(struct.pack(">i", round(value * 65536)) for value in white) + bytes(48)
    content = head + table + data
    return struct.pack(">I", len(content)) + content[4:]


RED, GREEN, BLUE = (0.4361, 0.2225, 0.0139), (0.3851, 0.7169, 0.0971), (0.1431, 0.0606, 0.7141)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF", "WEBP"])
def test_colours_of_another_profile_are_converted(kind: str) -> None:
    """Of one whose red and green are exchanged."""
    options: dict[str, Any] = {"quality": 100, "subsampling": 0} if kind == "JPEG" else {"lossless": True}
    options = {} if kind in ("PNG", "TIFF") else options
    content = packed(Image.fromarray(RGB), kind, icc_profile=profile(GREEN, RED, BLUE, b"exchanged"), **options)
    pixels, notes = read(content)
    assert np.abs(pixels.astype(int) - RGB[..., [1, 0, 2]]).mean() < 6
    assert notes == "a.img: its colours are converted from exchanged to sRGB"
    same, notes = read(packed(Image.fromarray(RGB), "PNG", icc_profile=profile(RED, GREEN, BLUE, b"sRGB of a camera")))
    np.testing.assert_array_equal(same, RGB)
    assert not notes


def test_cmyk_and_a_broken_profile_are_doubts() -> None:
    assert "CMYK without a profile" in read(packed(Image.fromarray(RGB).convert("CMYK"), "JPEG"))[1]
    pixels, notes = read(packed(Image.fromarray(RGB), "PNG", icc_profile=b"none"))
    np.testing.assert_array_equal(pixels, RGB)
    assert "a colour profile that cannot be read" in notes


def stored(orientation: int, kind: str, order: str = "<") -> bytes:
    """The file of an upright image as it is stored with an orientation."""
    image, turn = Image.fromarray(RGB), TO_STORED[orientation]
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    exif.endian = order
    options: dict[str, Any] = {"quality": 100, "subsampling": 0} if kind == "JPEG" else {}
    return packed(image if turn is None else image.transpose(turn), kind, exif=exif, **options)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
@pytest.mark.parametrize("orientation", TO_STORED)
def test_images_are_turned_as_exif_says(orientation: int, kind: str, order: str) -> None:
    content = stored(orientation, kind, order)
    header = image_header(content, "a")
    assert header.orientation == (1 if kind == "TIFF" else orientation) and header.upright == (36, 24)
    pixels, notes = read(content)
    assert np.abs(pixels.astype(int) - RGB).max() <= (4 if kind == "JPEG" else 0)
    if kind == "TIFF":  # Pillow gives these upright
        assert not notes
    else:
        said = f"a.img: is turned to 36x24 pixels (EXIF orientation {orientation})"
        assert notes == ("" if orientation == 1 else said)


def test_an_image_that_was_calibrated_as_it_is_stored_is_not_turned() -> None:
    content = stored(6, "PNG")
    pixels, notes = read(content, (24, 36))
    np.testing.assert_array_equal(pixels, np.asarray(Image.fromarray(RGB).transpose(Image.Transpose.ROTATE_90)))
    assert "is not turned" in notes and "EXIF orientation 6" in notes
    with pytest.raises(LogError, match="a.img: has 36x24 pixels, turned as its EXIF orientation 6 says, the camera is"):
        read(content, (72, 48))
    header = image_header(content)
    assert header.size(cx=18.3, cy=12.2) == (36, 24) and header.size(cx=11.7, cy=18.4) == (24, 36)


@pytest.mark.parametrize("orientation", [0, 9, 4711])
def test_an_orientation_that_there_is_not_is_none(orientation: int) -> None:
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    assert image_header(packed(Image.fromarray(RGB), "JPEG", exif=exif)).orientation == 1
