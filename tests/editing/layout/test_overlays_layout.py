"""What is drawn over a 3D view, in views of every size."""

from __future__ import annotations

from itertools import combinations, product

import pytest

from unisim_blender.editing.layout.overlays import (
    GIZMOS_PX,
    TEXT_PX,
    OverlayLayout,
    Rectangle,
    free_part,
    lay_out_overlays,
)

SIZES = [(300, 300), (377, 420), (620, 480), (800, 260), (1300, 730), (1920, 1080), (3840, 2160), (300, 2000)]
WANTED = {"timeline": (318.0, 260.0), "graph": (440.0, 214.0), "legend": (210.0, 150.0)}


def regions(width: float, height: float, scale: float) -> list[tuple[str, Rectangle]]:
    """A header and a tool header above, the toolbar at the left, the sidebar at the right where there is room for it."""
    top = height - 26 * scale
    boxes = [
        ("WINDOW", Rectangle(0, 0, width, height)),
        ("HEADER", Rectangle(0, top, width, height)),
        ("TOOL_HEADER", Rectangle(0, top - 26 * scale, width, top)),
        ("TOOLS", Rectangle(0, 0, 50 * scale, top - 26 * scale)),
        ("HUD", Rectangle(55 * scale, 5, 200 * scale, 30)),
        ("UI", Rectangle(width, 0, width + 1, top)),  # closed
    ]
    return boxes if width < 900 * scale else [*boxes[:-1], ("UI", Rectangle(width - 280 * scale, 0, width, top))]


def laid_out(size: tuple[int, int], scale: float, names: tuple[str, ...]) -> OverlayLayout:
    """Return the layout of some overlays in a view of a size."""
    return lay_out_overlays(free_part(*size, regions(*size, scale)), scale, {name: WANTED[name] for name in names})


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scale", [0.75, 1.0, 1.5, 2.0])
def test_nothing_covers_anything(size: tuple[int, int], scale: float) -> None:
    for count in range(len(WANTED) + 1):
        for names in combinations(WANTED, count):
            layout = laid_out(size, scale, names)
            free = layout.free
            gizmos = Rectangle(free.right - GIZMOS_PX[0] * scale, free.top - GIZMOS_PX[1] * scale, free.right, free.top)
            boxes = {**layout.overlays, "notices": layout.notices}
            covers = [box for kind, box in regions(*size, scale) if kind not in ("WINDOW", "HUD")]
            for (name, box), cover in product(boxes.items(), covers):
                assert not box.meets(cover), (name, box, cover)
            for (one, a), (other, b) in combinations(boxes.items(), 2):
                assert not a.meets(b), (one, a, other, b)
            for name, box in boxes.items():
                assert free.width < GIZMOS_PX[0] * scale or not box.meets(gizmos), (name, box, gizmos)
            if layout.overlays:
                assert layout.notices.height >= 0.3 * free.height - TEXT_PX * scale - 8 * scale


@pytest.mark.parametrize(("size", "scale"), [((1300, 730), 1.0), ((1920, 1080), 1.5), ((3840, 2160), 2.0)])
def test_ordinary_views_show_all_of_them(size: tuple[int, int], scale: float) -> None:
    layout = laid_out(size, scale, tuple(WANTED))
    assert set(layout.overlays) == set(WANTED) and layout.graph_scale >= 0.8 * scale
    timeline = layout.overlays["timeline"]
    assert timeline.height >= 100 * scale and timeline.left < layout.free.left + 20 * scale
    assert layout.overlays["graph"].bottom > timeline.top and layout.overlays["legend"].bottom > timeline.top


def test_a_small_view_shows_the_graph_or_the_timeline() -> None:
    assert set(laid_out((620, 480), 1.0, ("graph",)).overlays) == {"graph"}
    assert set(laid_out((620, 480), 1.0, ("timeline",)).overlays) == {"timeline"}
    assert laid_out((620, 480), 1.0, ()).overlays == {}
    narrow = lay_out_overlays(Rectangle(50, 0, 376, 400), 1.0, {name: WANTED[name] for name in ("timeline", "graph")})
    assert set(narrow.overlays) == {"graph"}, "there is no room for a timeline, but one for the graph"


def test_a_line_is_clear_of_what_it_crosses() -> None:
    layout = laid_out((1300, 730), 1.0, tuple(WANTED))
    graph, timeline = layout.overlays["graph"], layout.overlays["timeline"]
    assert layout.clear(graph.left + 5, graph.left + 6) == (graph.top, layout.free.top)
    between = (layout.overlays["legend"].right + graph.left) / 2
    assert layout.clear(between, between + 1)[0] == timeline.top
