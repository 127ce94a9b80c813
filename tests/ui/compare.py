"""Recorded and rendered images in one view, unsupported pixels, and a view from outside, with mouse and keys.
Run by `run.py`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Vector
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from buttons import open_panel, press
from hands import click, event, import_dropped, key, middle, sidebar, to
from heart import uncounted
from session import ARCHIVE, MODULE, OUT, results, screenshot, start, until, view, wait_for_image
from tasks import bare_view, begin, task

SAME_BYTES = 2.0
MODES = ("RENDERED", "SPLIT", "DIFFERENCE", "FLICKER", "RECORDED")
"""In the order in which the header's menu has them."""
FRAME = 9
ENTRY_PX = 52, 23
"""How far below the header's field its menu's first entry is, and how far apart entries are."""
LONGEST: dict[str, float] = {}
"""Seconds of the main thread's own time, by what took it."""


def shown() -> Any:
    """The image that the engine draws into the 3D view."""
    found, _, _ = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    return sys.modules[f"{MODULE}.viewport.compare_view"].drawn_view(region)


def options() -> Any:
    """The 3D view's options."""
    return sys.modules[f"{MODULE}.viewport.options"].options_of(view()[1])


@uncounted
def screen(name: str) -> NDArray[np.float32]:
    """What the screen shows of the view's image: (H, W, 3) in steps of eight bits, lowest row first, clear of labels
    and of what lies at the view's edges; and where that begins in the image."""
    screenshot(name)
    image = bpy.data.images.load(str(OUT / f"{name}.png"), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3]
    bpy.data.images.remove(image)
    region = next(r for r in view()[0].regions if r.type == "WINDOW")
    rows, columns = inner()
    left, bottom, _, _ = shown().rectangle
    return (
        255
        * pixels[
            region.y + bottom + rows.start : region.y + bottom + rows.stop,
            region.x + left + columns.start : region.x + left + columns.stop,
        ]
    )


def inner() -> tuple[slice, slice]:
    """Rows and columns of the view's image that nothing lies over."""
    region = next(r for r in view()[0].regions if r.type == "WINDOW")
    panel = next((r.width for r in view()[0].regions if r.type == "UI"), 0)
    left, bottom, width, height = shown().rectangle
    columns = slice(max(left, 80) - left, min(left + width, region.width - panel - 40) - left)
    return slice(max(bottom + 80, 80) - bottom, min(bottom + height, region.height - 110) - bottom), columns


@uncounted
def recorded() -> NDArray[np.float32]:
    """The recorded image at the view's size, from its file by Blender's own reader and a plain bilinear or mean:
    (H, W, 3) in steps of eight bits, lowest row first."""
    comparison = shown().comparison
    wanted = comparison._request
    image = bpy.data.images.load(str(wanted.log.image_path(wanted.camera, wanted.frame)), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    w, h = image.size
    pixels = 255 * np.array(image.pixels[:], np.float32).reshape(h, w, -1)[..., :3]
    bpy.data.images.remove(image)
    _, _, width, height = shown().rectangle
    for axis, (old, new) in enumerate(((h, height), (w, width))):
        at = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
        low = np.minimum(at.astype(int), old - 2)
        share = (at - low).astype(np.float32)
        a, b = np.take(pixels, low, axis), np.take(pixels, low + 1, axis)
        share = share.reshape([-1 if axis == i else 1 for i in range(3)])
        pixels = a + share * (b - a)
    return pixels


def rendered() -> NDArray[np.float32]:
    """The rendered image, as `recorded`."""
    return shown().srgb.astype(np.float32)


@uncounted
def apart(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """The share of pixels that are more than two steps apart."""
    assert a.shape == b.shape and a.size > 10000, (a.shape, b.shape)
    return float((np.abs(a - b).max(-1) > SAME_BYTES).mean())


def header_field() -> tuple[float, float]:
    """Where the header has the field that says which images are shown: the last one."""
    header = next(r for r in view()[0].regions if r.type == "HEADER")
    return header.x + header.width - 60, header.y + header.height / 2


def choose_mode(mode: str) -> Iterator[float]:
    """Open the header's menu of images with a click, and click on one of its entries."""
    yield from to(*header_field())
    yield 0.2
    yield from click()
    yield 0.4
    screenshot("menu_of_images")
    x, y = header_field()
    yield from to(x, y - ENTRY_PX[0] - ENTRY_PX[1] * MODES.index(mode))
    yield 0.3
    yield from click()
    yield from until(lambda: options().mode == mode, f"the header does not set {mode}, but {options().mode}", 10)
    yield from to(*middle(view()[0]))
    yield 0.3


def first_import() -> Iterator[float]:
    """A trained scene dropped onto Blender's default file, Rendered shading through its camera."""
    yield from import_dropped()
    bpy.context.scene.frame_set(FRAME)
    _, space, _ = view()
    space.shading.type = "RENDERED"
    bare_view(space)
    space.show_gizmo = space.overlay.show_text = True
    yield from wait_for_image()
    yield 0.5


def measured() -> None:
    """Note, from now on, the longest that one drawing of the view took of the main thread's time, in seconds."""
    view_class: Any = sys.modules[f"{MODULE}.viewport.views"].ViewportImage
    for name in ("follow", "gather", "draw"):
        setattr(view_class, name, timed(name, getattr(view_class, name)))


def timed(name: str, todo: Callable[..., Any]) -> Callable[..., Any]:
    """The same method, which notes its longest time."""

    def noted(*arguments: Any) -> Any:
        begun = time.thread_time()
        try:
            return todo(*arguments)
        finally:
            took = round(time.thread_time() - begun, 3)
            LONGEST[name] = max(LONGEST.get(name, 0.0), took)
            results["longest_s"] = LONGEST

    return noted


def split() -> Iterator[float]:
    """Split, chosen in the header, and its line dragged to a third of the image."""
    yield from choose_mode("SPLIT")
    yield from until(
        lambda: not shown().expects and shown().comparison._shown is not None, "no recorded image comes", 20
    )
    yield 0.5
    yield from judged_split("split_half", 0.5)
    region = next(r for r in view()[0].regions if r.type == "WINDOW")
    left, bottom, width, height = shown().rectangle
    y = region.y + bottom + height * 0.6
    yield from to(region.x + left + width * 0.5 - 40, y)
    yield 0.2
    yield from to(region.x + left + width * 0.5, y)
    yield 0.3
    event("LEFTMOUSE", "PRESS")
    yield 0.1
    for share in np.linspace(0.48, 0.3, 8):
        yield from to(region.x + left + width * share, y)
        yield 0.05
    screenshot("split_dragging")
    event("LEFTMOUSE", "RELEASE")
    yield 0.3
    assert abs(options().split - 0.3) < 0.02, f"the line is at {options().split:.2f} after it was dragged to 0.3"
    yield from judged_split("split_third", options().split)


def judged_split(name: str, at: float) -> Iterator[float]:
    """Left of the line stands the recorded image, right of it the rendered one."""
    rows, columns = inner()
    width = shown().rectangle[2]
    edge = round(at * width)
    on = screen(name)
    left = slice(0, edge - 10 - columns.start)
    right = slice(edge + 10 - columns.start, None)
    told = {
        "left": apart(on[:, left], recorded()[rows, columns][:, left]),
        "right": apart(on[:, right], rendered()[rows, columns][:, right]),
        "left_is_render": apart(on[:, left], rendered()[rows, columns][:, left]),
    }
    results[name] = told
    assert told["left"] < 0.01 and told["right"] < 0.01 and told["left_is_render"] > 0.3, (name, told)
    yield 0.1


def recorded_mode() -> Iterator[float]:
    """The recorded image alone, and that of the next frame."""
    yield from choose_mode("RECORDED")
    for step in range(2):
        yield from until(
            lambda: not shown().expects and shown().comparison._shown is not None, "no recorded image comes", 20
        )
        yield 0.5
        rows, columns = inner()
        share = apart(screen(f"recorded_{step}"), recorded()[rows, columns])
        results[f"recorded_{step}"] = share
        assert share < 0.01, f"{share:.1%} of the pixels are not the recorded image's"
        yield from key("RIGHT_ARROW")
        yield 0.3
    bpy.context.scene.frame_set(FRAME)
    yield 0.3


def difference() -> Iterator[float]:
    """The difference, four times, with its figures."""
    yield from choose_mode("DIFFERENCE")
    yield from wait_for_image()
    yield from until(lambda: "PSNR" in shown().comparison.metrics, "no figures come", 20)
    yield 0.5
    rows, columns = inner()
    expected = np.clip(4 * np.abs(shown().comparison._shown.srgb.astype(np.float32) - rendered()), 0, 255)
    on = screen("difference")
    # Blender's display transform mixes saturated colours by a few hundredths
    share = float((np.abs(on - expected[rows, columns]).max(-1) > 8).mean())
    results["difference"], results["figures"] = share, shown().comparison.metrics
    assert share < 0.02, f"{share:.1%} of the pixels are not the difference"


def flicker() -> Iterator[float]:
    """Recorded and rendered by turns; the clock stops when another mode is chosen."""
    yield from choose_mode("FLICKER")
    module = sys.modules[f"{MODULE}.viewport.compare_view"]
    yield from wait_for_image()
    rows, columns = inner()
    pair = recorded()[rows, columns], rendered()[rows, columns]
    seen: list[str] = []
    for turn in range(10):
        on = screen("flicker")
        shares = [apart(on, one) for one in pair]
        seen.append("recorded" if shares[0] < 0.01 else "rendered" if shares[1] < 0.01 else f"neither {shares}")
        if turn == 0:
            screenshot("flicker_first")
        yield 0.13
    results["flicker"] = seen
    assert set(seen) == {"recorded", "rendered"}, seen
    assert bpy.app.timers.is_registered(module._turn)
    yield from choose_mode("RENDERED")
    yield 0.6
    assert not bpy.app.timers.is_registered(module._turn), "it goes on redrawing"


def no_recorded_image() -> Iterator[float]:
    """In a free view, and after the last frame, the view says why there is no recorded image, and shows
    the rendered one."""
    yield from choose_mode("SPLIT")
    from_above()
    yield from only_rendered("free_view_split", "no recorded image")
    view()[2].view_perspective = "CAMERA"
    yield from wait_for_image()
    yield from until(
        lambda: not shown().expects and shown().comparison._shown is not None, "no recorded image comes", 20
    )
    yield 0.5
    yield from judged_split("split_again", options().split)
    bpy.context.scene.frame_set(bpy.context.scene.frame_end)
    yield from wait_for_image()
    yield from key("RIGHT_ARROW")
    beyond = bpy.context.scene.frame_end + 1
    yield from until(lambda: bpy.context.scene.frame_current == beyond, "the arrow key shows no later frame", 5)
    yield from only_rendered("after_the_end_split", f"no recorded image of frame {beyond}", marked=True)
    bpy.context.scene.frame_set(FRAME)
    yield from choose_mode("RENDERED")


def only_rendered(name: str, sentence: str, marked: bool = False) -> Iterator[float]:
    """The view says a sentence, and shows the rendered image on both sides of where the split's line was; ``marked``:
    dimmed and striped, as frames outside the drive are."""
    yield from wait_for_image()
    yield 0.5
    results[name] = shown().sentence
    assert sentence in shown().sentence, shown().sentence
    rows, columns = inner()
    on, image = screen(name), rendered()
    there = np.ones(on.shape[:2], bool)
    if shown().wanted["clip"]:  # what nothing recorded shows is left out from outside
        there = ~shown().unsupported[rows, columns]
    assert there.mean() > 0.05, "the view shows next to nothing"
    share = apart_where(on, (outside_marked(image) if marked else image)[rows, columns], there)
    results[f"{name}_apart"] = share
    assert share < 0.01, f"{share:.1%} of the pixels are not the rendered image's"


@uncounted
def outside_marked(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """An image in steps of eight bits as a frame outside the drive is shown: a quarter of its light, under diagonal
    stripes of grey 0.35, ten pixels wide, that let half of it through."""
    share = image / 255
    light = 0.25 * np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    striped = (np.arange(image.shape[0])[:, None] + np.arange(image.shape[1])) // 10 % 2 == 0
    light = np.where(striped[..., None], 0.5 * light + 0.5 * 0.35, light)
    return np.asarray(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055), np.float32)


def from_above(distance_m: float = 45.0, tilt: float = 35.0, turn: float = -90.0) -> None:
    """Look down at the street ahead of the vehicle, through no camera."""
    _, space, looks = view()
    ego = next(o for o in bpy.context.scene.objects if o.unisim.kind == "EGO")
    looks.view_perspective = "PERSP"
    looks.view_location = ego.matrix_world.translation + Vector((14.0, 0.0, 0.0))
    looks.view_rotation = Euler((np.radians(tilt), 0.0, np.radians(turn))).to_quaternion()
    looks.view_distance = distance_m
    looks.update()


def unsupported() -> Iterator[float]:
    """Hatching over unsupported pixels, switched on in the panel; the image below stays."""
    yield from open_panel("Show", "unsupported")
    screenshot("show_panel")
    from_above()
    options().clip = False
    yield from wait_for_image()
    yield 0.3
    plain = screen("outside_unclipped")
    assert shown().unsupported is None, "a pass that nobody asked for"
    yield from press("unsupported")
    yield from to(*middle(view()[0]))
    yield from until(lambda: options().unsupported, "the switch does not answer", 10)
    yield from wait_for_image()
    yield 0.5
    on = screen("unsupported")
    rows, columns = inner()
    mask = shown().unsupported[rows, columns]
    changed = np.abs(on - plain).max(-1) > 8
    results["unsupported"] = [float(share) for share in (mask.mean(), changed[mask].mean(), changed[~mask].mean())]
    assert 0.2 < mask.mean() < 0.95
    assert 0.35 < changed[mask].mean() < 0.65 and changed[~mask].mean() < 0.01, results["unsupported"]
    options().unsupported = False


def clipped() -> Iterator[float]:
    """From above, behind and the side the street is seen, with nothing round it."""
    for name, tilt, turn, away in (
        ("behind", 62.0, -90.0, 38.0),
        ("above", 15.0, -90.0, 60.0),
        ("side", 62.0, 180.0, 48.0),
    ):
        from_above(away, tilt, turn)
        for clip in (False, True):
            options().clip = clip
            yield from wait_for_image()
            yield 0.5
            on = screen(f"{'clipped' if clip else 'unclipped'}_{name}")
            if clip:
                rows, columns = inner()
                gone = shown().unsupported[rows, columns]
                results[f"clipped_{name}"] = float(gone.mean())
                ground = on[gone]
                assert 0.1 < gone.mean() < 0.97, gone.mean()
                assert ground.std(0).max() < 12, "what is clipped shows something"
                assert apart_where(on, rendered()[rows, columns], ~gone) < 0.02
    view()[2].view_perspective = "CAMERA"
    yield from wait_for_image()
    assert shown().wanted["clip"] is False and shown().wanted["passes"] == ["rgb"]


@uncounted
def apart_where(a: NDArray[np.float32], b: NDArray[np.float32], where: NDArray[np.bool_]) -> float:
    """`apart` of some pixels."""
    return float((np.abs(a - b).max(-1)[where] > SAME_BYTES).mean())


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    yield from task("compare_import", first_import)
    measured()
    yield from sidebar()
    for name, todo in (
        ("split", split),
        ("recorded_mode", recorded_mode),
        ("difference_mode", difference),
        ("flicker_mode", flicker),
        ("no_recorded_image", no_recorded_image),
        ("unsupported_pixels", unsupported),
        ("clipped_views", clipped),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "compare")
