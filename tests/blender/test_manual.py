"""The manual inside the extension: every button and setting has a section there."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import bpy
import pytest

from unisim_blender.features.drive import properties as properties_
from unisim_blender.operators import documentation
from unisim_blender.registering import classes_of

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def maker() -> Any:
    """tools/build_manual.py."""
    spec = importlib.util.spec_from_file_location("build_manual", ROOT / "tools" / "build_manual.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def manual(maker: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the manual, built."""
    return Path(maker.build(tmp_path_factory.mktemp("manual"))).parent


def section_of(name: str) -> str | None:
    """The file that Blender opens for one of its names, as its own operator finds it."""
    import bl_operators.wm as wm

    return wm.WM_OT_doc_view_manual._find_reference(name, documentation.manual_map()[1], verbose=False)


def ours() -> list[str]:
    """Blender's names of our operators, their settings, our property groups', preferences' and panels'."""
    names = []
    for name in dir(bpy.ops.unisim):
        properties = getattr(bpy.ops.unisim, name).get_rna_type().properties
        names += [
            f"bpy.ops.unisim.{name}",
            *(f"bpy.ops.unisim.{name}.{p}" for p in properties.keys() if p != "rna_type"),
        ]
    for group in classes_of(properties_):
        names += [f"bpy.types.{group.__name__}.{name}" for name in group.bl_rna.properties.keys()]
    names += [f"bpy.types.{name}" for name in dir(bpy.types) if name.startswith("UNISIM_PT")]
    return [*names, "bpy.types.UniSimPreferences.interpreter", "bpy.types.Scene.unisim"]


def test_every_operator_and_setting_has_its_section(addon: Any, manual: Path) -> None:
    names = ours()
    assert len(names) > 60
    anchors = set(re.findall(r'id="([^"]+)"', (manual / "index.html").read_text()))
    for name in names:
        file = section_of(name)
        assert file is not None, name
        assert (manual / file).is_file(), f"{name}: {file}"
        if file != "index.html":
            (leads,) = re.findall(r"url=index\.html#([^\"]+)", (manual / file).read_text())
            assert leads in anchors, f"{name}: {leads}"
    assert (
        section_of("bpy.ops.unisim.train") == "train.html" and section_of("bpy.ops.unisim.import_log") == "import.html"
    )
    assert section_of("bpy.ops.mesh.bevel") is None


def test_blender_opens_the_page_from_disk(addon: Any, manual: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url, *_: opened.append(url))
    monkeypatch.setattr(documentation, "MANUAL", manual)
    documentation.register()
    try:
        assert bpy.ops.wm.doc_view_manual(doc_id="unisim.render_sequence") == {"FINISHED"}
    finally:
        documentation.unregister()
    assert opened == [(manual / "sequences.html").as_uri()]
    assert not any(hook is documentation.manual_map for hook in bpy.utils._manual_map)


def test_the_page_is_whole(maker: Any, manual: Path) -> None:
    text = (manual / "index.html").read_text()
    for image in re.findall(r'<img src="([^"]+)"', text):
        assert (manual / image).is_file()
    for anchor in re.findall(r'href="#([^"]+)"', text):
        assert f'id="{anchor}"' in text
    body = re.sub(r"<[^>]+>", "", text.split("<body>")[1])
    assert "**" not in body and "](" not in body and "```" not in body
    for tag in ("p", "ul", "ol", "li", "table", "tr", "td", "code", "strong"):
        assert len(re.findall(rf"<{tag}[ >]", text)) == text.count(f"</{tag}>"), tag


def test_markdown_becomes_html(maker: Any) -> None:
    made = list(
        maker.blocks(
            [
                *("# A *b* `<c>`", "", "text **bold**", "[on](https://x.org) [off](other.md)", ""),
                *("- one", "  more", "  - inner", "- two", "", "1. first", "2. last", ""),
                *("| a | b |", "|---|---|", "| `x` | y |", "", "```", "<raw>", "```"),
            ]
        )
    )
    assert made == [
        '<h1 id="a-b-c">A <em>b</em> <code>&lt;c&gt;</code></h1>',
        '<p>text <strong>bold</strong> <a href="https://x.org">on</a> off</p>',
        "<ul><li>one more<ul><li>inner</li></ul></li><li>two</li></ul>",
        "<ol><li>first</li><li>last</li></ol>",
        "<table><tr><th>a</th><th>b</th></tr><tr><td><code>x</code></td><td>y</td></tr></table>",
        "<pre><code>&lt;raw&gt;</code></pre>",
    ]
