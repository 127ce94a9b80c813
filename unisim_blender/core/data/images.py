"""Recorded images at the size that is trained and measured, and as the files that they are."""

from __future__ import annotations

import io
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms, ImageOps, UnidentifiedImageError

from ..errors import LogError, in_a_line
from ..geometry import BoolArray
from ..json_file import read_bytes
from ..sensors.unprojection import image_mask
from ..world.drive import CameraModel
from .image_files import UPRIGHT, ImageHeader, Notes, image_header
from .log import Log

SIGNATURES = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png"}
"""First bytes of image files that are copied unchanged."""
FULL_SCALE = 65535 // 255
"""Divisor from a value of 16 bits to one of 8."""
DIM = 64
"""Largest value, of 255, of an image of more than 8 bits at which it may use fewer bits than its file has."""
SRGB_GAMMA, GAMMA_OFF = 1 / 2.2, 0.02
_ROWS = 32


def read_image(
    source: Path | bytes, size: tuple[int, int], stated: str, notes: Notes, camera: str, where: str = ""
) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3), sRGB, of an image's file, or of its bytes, which ``where`` names.

    ``size``: width and height that it must have, as ``stated`` says: "the table gives 1600x900". It is turned as EXIF
    says where it then has that size. Grey images of 16 bits are scaled to 8, colours of another profile are converted.
    What was done and what is doubtful is noted once a ``camera``. Raises `LogError` for another size, numbers of which
    nothing states the range, and a file that cannot be decoded.
    """
    where = where or str(source)
    header = image_header(source, where)
    turned = header.orientation != UPRIGHT and header.upright == size
    if not turned and header.stored != size:
        size_text = "{}x{} pixels".format(*header.upright)
        exif = "" if header.stored == header.upright else f", turned as its EXIF orientation {header.orientation} says"
        raise LogError(f"{where}: has {size_text}{exif}, {stated}")
    if header.orientation != UPRIGHT:
        done = (
            f"is turned to {size[0]}x{size[1]} pixels"
            if turned
            else "is not turned: the camera is calibrated for it so"
        )
        notes.say(f"turned {camera}", f"{where}: {done} (EXIF orientation {header.orientation})")
    try:
        with Image.open(io.BytesIO(source) if isinstance(source, bytes) else source) as image:
            pixels = rgb_pixels(image if header.plain else _as_srgb(image, header, notes, camera, where))
    except UnidentifiedImageError as error:
        raise LogError(f"{where}: is no image") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError, ImageCms.PyCMSError) as error:
        raise LogError(f"{where}: cannot be decoded ({in_a_line(error)})") from error
    if turned:
        upright = Image.fromarray(pixels)
        upright.getexif()[0x0112] = header.orientation
        pixels = np.asarray(ImageOps.exif_transpose(upright))
    if header.bits > 8 and pixels.max() < DIM:
        notes.say(
            f"dim {camera}",
            f"{where}: has {header.bits} bits a channel, of which its brightest pixel fills {pixels.max() / 255:.1%}: it is "
            "taken as dark as that",
        )
    return pixels


def _as_srgb(image: Image.Image, header: ImageHeader, notes: Notes, camera: str, where: str) -> Image.Image:
    """Return an image of any kind as one of 8 bits a channel in sRGB. Raises `LogError`."""
    if image.mode.startswith("I;16") or (image.mode == "I" and image.format == "PNG"):
        values = np.asarray(image).astype(np.uint32)
        return Image.fromarray(((values + FULL_SCALE // 2) // FULL_SCALE).astype(np.uint8))
    if image.mode in ("I", "F"):
        values = np.asarray(image)
        what = "32-bit whole numbers" if image.mode == "I" else "32-bit floats"
        raise LogError(
            f"{where}: holds {what} from {values.min():g} to {values.max():g}, not colours of 8 or 16 bits: of these "
            "nothing states what is white"
        )
    frames = getattr(image, "n_frames", 1)
    if frames > 1 and image.format != "MPO":
        notes.say(f"frames {camera}", f"{where}: holds {frames} images, of which the first is read")
    if image.has_transparency_data:
        alpha = np.asarray(image.convert("RGBA").getchannel("A"))
        if alpha.min() < 255:
            share = float((alpha < 255).mean())
            notes.say(
                f"alpha {camera}",
                f"{where}: is transparent in {share:.1%} of its pixels: their colours are taken as they are",
            )
    gamma = image.info.get("gamma")
    profile = image.info.get("icc_profile")
    if gamma and "srgb" not in image.info and not profile and abs(gamma - SRGB_GAMMA) > GAMMA_OFF:
        notes.say(
            f"gamma {camera}",
            f"{where}: states a gamma of {gamma:g}, not sRGB's {SRGB_GAMMA:.4g}: it is read as if it were sRGB",
        )
    if profile and image.mode in ("RGB", "CMYK", "RGBA"):
        image = _from_profile(image, profile, notes, camera, where)
    elif image.mode == "CMYK":
        notes.say(f"profile {camera}", f"{where}: is in CMYK without a profile: its colours are a guess")
    return image


def _from_profile(image: Image.Image, profile: bytes, notes: Notes, camera: str, where: str) -> Image.Image:
    """Return an image whose colours are those of an ICC profile, in sRGB."""
    name, transform = _transform(profile, image.mode)
    if transform is None:
        if not name:
            notes.say(
                f"profile {camera}", f"{where}: has a colour profile that cannot be read: it is read as if it were sRGB"
            )
        return image
    notes.say(f"profile {camera}", f"{where}: its colours are converted from {name} to sRGB")
    return ImageCms.applyTransform(image.convert("RGB") if image.mode == "RGBA" else image, transform) or image


@lru_cache(maxsize=8)
def _transform(profile: bytes, mode: str) -> tuple[str, ImageCms.ImageCmsTransform | None]:
    """Return the name of an ICC profile, and what takes its colours to sRGB, none where they are; no name where it is
    none."""
    try:
        given = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = ImageCms.getProfileDescription(given).strip()
        if "srgb" in name.lower():
            return name, None
        target = ImageCms.createProfile("sRGB")
        return name or "its profile", ImageCms.buildTransform(given, target, "CMYK" if mode == "CMYK" else "RGB", "RGB")
    except (OSError, ImageCms.PyCMSError):
        return "", None


def rgb_pixels(image: Image.Image) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3) uint8 of an image that Pillow opened, sRGB.

    Rows are copied a few at a time, which stay in a processor's cache: all at once take as long as decoding them.
    """
    pixels = np.empty((image.height, image.width, 3), np.uint8)
    for row in range(0, image.height, _ROWS):
        part = image.crop((0, row, image.width, min(row + _ROWS, image.height)))
        pixels[row : row + _ROWS] = part if part.mode == "RGB" else part.convert("RGB")
    return pixels


def resize_image(rgb: NDArray[np.uint8], model: CameraModel) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) uint8 at the camera model's size, each new pixel the mean of what it covers."""
    if rgb.shape[:2] == (model.height, model.width):
        return rgb
    return np.asarray(Image.fromarray(rgb).resize((model.width, model.height), Image.Resampling.BOX))


@lru_cache(maxsize=16)
def shown_pixels(recorded: CameraModel, model: CameraModel) -> BoolArray | None:
    """Return the pixels (H, W) bool of a recorded image at ``model``'s size whose colour is from pixels alone that the
    lens shows; None where all are. At the border, a pixel of a resized image covers some that are black."""
    shown, own = image_mask(model), image_mask(recorded)
    if own is None or own.shape == (model.height, model.width):
        return shown
    covered = resize_image(np.repeat(np.uint8(255) * own[..., None], 3, 2), model)[..., 0] == 255
    mask = covered if shown is None else covered & shown
    mask.flags.writeable = False
    return mask


def encoded_image(log: Log, camera: str, frame: int) -> NDArray[np.uint8] | bytes:
    """Return a recorded image's file unchanged where it is a JPEG or PNG whose pixels are the image's; else its pixels
    (H, W, 3) uint8, as for an image that is rotated or has 16 bits a channel. Raises `LogError`."""
    encoded = getattr(log, "encoded_image", None)
    if encoded is not None:
        content = bytes(encoded(camera, frame))
    else:
        path = log.image_path(camera, frame)
        if path is None:
            return log.image(camera, frame)
        content = read_bytes(path, LogError)
    if content.startswith(tuple(SIGNATURES)) and image_header(content, f"{log.path}: {camera}: image {frame}").plain:
        return content
    return log.image(camera, frame)
