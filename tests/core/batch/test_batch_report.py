"""The report of a batch: its rows and images, hostile names, and the page in a browser without a network."""

from __future__ import annotations

import html.parser
import io
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from headless_page import CHROMIUM, HeadlessPage
from PIL import Image

from unisim_blender.core.batch.records import Store
from unisim_blender.core.batch.report import batch_report, report_page, rows_of, write_report
from unisim_blender.core.cli.main import run
from unisim_blender.core.errors import OutputError

HOSTILE = '</script><img src=x onerror="window.hacked=1">&"\'<b>'


def png(value: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.full((90, 160, 3), value, np.uint8)).save(file, "PNG")
    return file.getvalue()


def rollout(number: int, scores: Any, first: int = 0) -> dict[str, Any]:
    files: dict[str, Any] = {f"rollouts/v{number}/camera/front/t{1000000 * i:013d}us.png": {} for i in range(first, 5)}
    files[f"rollouts/v{number}/depth/front/t0000000000000us.png"] = {}
    return {
        "scenario": {"name": "cut-in"},
        "parameters": {"gap_m": 2.0 * number, "who": HOSTILE if number == 1 else "car-01", "on": [1, None]},
        "driver": "idm",
        "seed": None,
        "rollout": {"files": files, "scores": scores},
        "repeat": ["drive", f"variants/v{number}/scenario.json", "--driver", "idm", "--renderer", "surfel"],
    }


def scores(hits: int, pdms: float | None, first_s: float | None = None) -> dict[str, Any]:
    return {"collision": {"count": hits, "first_s": first_s}, "pdms": {"score": pdms}, "off_road": {"off_road": False}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a batch of four rollouts leaves, of which one collided, one failed, and one is missing."""
    folder = tmp_path_factory.mktemp("report")
    unrun = {name: value for name, value in rollout(2, {}).items() if name != "rollout"}
    variants = {
        "v0": rollout(0, scores(0, 1.0)),
        "v1": rollout(1, scores(2, 0.25, 2.5)),
        "v2": unrun,
        "v3": {**unrun, "parameters": {"gap_m": 6.0}},
    }
    manifest = {
        "format": "unisim-batch", "version": 1, "counts": {"asked": 0, "rendered": 0, "shared": 0, "units": 4},
        "unfinished": ["000002", "000003"], "variants": variants, "captures": {},
    }  # fmt: skip
    failure = {"unit": "000002", "variant": "v2", "reason": f"no space {HOSTILE}", "command": "unisim drive x"}
    store = Store(str(folder))
    store.write("manifest.json", json.dumps(manifest).encode())
    store.write("failures/000002.json", json.dumps(failure).encode())
    for number in (0, 1):
        for index, name in enumerate(variants[f"v{number}"]["rollout"]["files"]):
            if index != 4:
                store.write(name, png(10 * index))
    store.write("rollouts/v0/camera/front/t0000004000000us.png", b"no image")
    write_report(store)
    return folder


class Elements(html.parser.HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


def test_it_counts_collisions_of_what_is_valid_throughout(tmp_path: Path) -> None:
    invalid = {"validity": {"invalid_steps": 3, "valid_until_s": 1.5}, "valid_part": {"collision": {"count": 0}}}
    valid = {"validity": {"invalid_steps": 0, "valid_until_s": 4.0}}
    variants = {"v0": rollout(0, scores(1, 0.0) | invalid), "v1": rollout(1, scores(0, 1.0) | valid)}
    manifest = {
        "format": "unisim-batch", "version": 1, "counts": {"units": 2}, "unfinished": [], "variants": variants,
        "captures": {},
    }  # fmt: skip
    assert [row.scores.get("collisions, valid part") for row in rows_of(manifest, [])] == [0, None]
    Store(str(tmp_path)).write("manifest.json", json.dumps(manifest).encode())
    text = "".join(Elements(batch_report(Store(str(tmp_path))).decode()).text)
    assert "1 with a collision, 1 valid throughout, 0 of these with a collision" in text


def test_rows_say_what_became_of_each_variant(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_bytes())
    rows = rows_of(manifest, [{"variant": "v2"}])
    assert [row.state for row in rows] == ["finished", "finished", "failed", "unfinished"]
    assert [row.collided for row in rows] == [False, True, False, False]
    assert rows[1].scores == {"collisions": 2, "first at, s": 2.5, "PDMS": 0.25, "off road": False}
    # the first image, that of the contact, and the last
    assert [name[-8:-6] for name in rows[1].images] == ["00", "00", "00"]
    assert [int(name.rsplit("t", 1)[1][:-6]) for name in rows[1].images] == [0, 3000000, 4000000]
    assert [int(name.rsplit("t", 1)[1][:-6]) for name in rows[0].images] == [0, 2000000, 4000000]


def test_images_that_others_lack_are_shown() -> None:
    moments = [
        {f"{i:06d}": {"camera/front": f"id{i if i < 4 else 10 * n + i}", "lidar/top": "l"} for i in range(6)}
        for n in (0, 1)
    ]
    names = {one["camera/front"] for moment in moments for one in moment.values()}
    captures: dict[str, Any] = {name: {"files": {f"captures/{name}/camera/front/0.png": {}}} for name in names}
    captures["l"] = {"files": {"captures/l/lidar/top/0.npz": {}}}
    variants = {f"v{n}": {"moments": moment} for n, moment in enumerate(moments)}
    manifest = {"variants": variants, "captures": captures}
    rows = rows_of(manifest, [])
    assert [list(row.images) for row in rows] == [
        ["captures/id4/camera/front/0.png", "captures/id5/camera/front/0.png"],
        ["captures/id14/camera/front/0.png", "captures/id15/camera/front/0.png"],
    ]
    del captures["l"]
    assert [row.state for row in rows_of(manifest, [])] == ["unfinished", "unfinished"]


def test_the_page_is_whole_and_escaped(folder: Path) -> None:
    data = (folder / "report.html").read_bytes()
    assert data == batch_report(Store(str(folder))), "a function of the batch"
    assert str(folder) not in data.decode()
    page = Elements(data.decode())
    assert len(page.of("script")) == len(page.of("style")) == 1 and not page.of("b")
    assert all(not name.startswith("on") for _, attributes in page.found for name in attributes)
    images = [str(one["src"]) for one in page.of("img")]
    assert len(images) == 2 and all(source.startswith("data:image/jpeg;base64,") for source in images)
    text = "".join(page.text)
    assert f"no space {HOSTILE}" in text and "2 finished, 1 failed, 1 unfinished, 1 with a collision" in text
    commands = [line for line in page.text if line.startswith("unisim drive variants/")]
    assert shlex.split(commands[1]) == [
        "unisim", "drive", "variants/v1/scenario.json", "--driver", "idm", "--renderer", "surfel", "--out", "repeat-v1",
    ]  # fmt: skip
    assert page.of("a")[0]["href"] == "rollouts/v0/"


def test_a_report_elsewhere_names_whole_places(folder: Path, tmp_path: Path) -> None:
    assert run(["batch", "report", str(folder), "--out", str(tmp_path / "page.html")]) == 0
    page = Elements((tmp_path / "page.html").read_text())
    assert page.of("a")[0]["href"] == (folder / "rollouts" / "v0").as_uri() + "/"
    assert any(line.startswith(f"unisim drive {folder}/variants/v0/") for line in page.text)


@pytest.mark.parametrize(
    ("manifest", "sentence"), [(None, "not written yet"), (b"{", "is none of a batch"), (b"[]", "is none of a batch")]
)
def test_what_has_no_manifest_is_one_sentence(tmp_path: Path, manifest: bytes | None, sentence: str) -> None:
    if manifest is not None:
        (tmp_path / "manifest.json").write_bytes(manifest)
    with pytest.raises(OutputError, match=rf"manifest\.json: .*{sentence}"):
        batch_report(Store(str(tmp_path)))


def test_a_batch_without_rollouts_has_no_scores() -> None:
    manifest: dict[str, Any] = {"variants": {"a": {"moments": {}, "parameters": {}}}, "captures": {}}
    page = report_page("a", {"asked": 4, "rendered": 3, "shared": 1, "units": 1}, rows_of(manifest, []), [], [""])
    found = Elements(page)
    assert "4 captures asked for, 3 rendered, 1 shared by variants." in found.text
    assert [one["data-role"] for one in found.of("th") if one.get("data-role")] == []


VISIBLE = "[...document.querySelectorAll('#variants tbody tr')].filter(r => !r.hidden).map(r => r.querySelector('a').textContent)"


def put(column: str, value: str) -> str:
    """Return the expression that writes into a filter, as a person does."""
    find = f"[...document.querySelectorAll('#variants input, #variants select')].find(f => f.ariaLabel === {column!r})"
    return f"(f => {{ f.value = {value!r}; f.dispatchEvent(new Event(f.tagName === 'INPUT' ? 'input' : 'change')) }})({find})"


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_page_filters_and_sorts_in_a_browser(folder: Path, tmp_path: Path) -> None:
    with HeadlessPage((folder / "report.html").as_uri(), tmp_path) as page:
        assert page.evaluate(VISIBLE) == ["v0", "v1", "v2", "v3"]
        assert page.evaluate("document.images.length && [...document.images].every(i => i.naturalWidth > 200)")
        page.evaluate(put("gap_m, least", "1"))
        page.evaluate(put("gap_m, most", "4"))
        assert page.evaluate(VISIBLE) == ["v1", "v2"]
        assert page.evaluate("document.getElementById('shown').textContent").startswith("2 of 4 variants are shown.")
        page.evaluate(put("PDMS, most", "0.5"))
        assert page.evaluate(VISIBLE) == ["v1"]
        for column in ("gap_m, least", "gap_m, most", "PDMS, most"):
            page.evaluate(put(column, ""))
        choices = "[...document.querySelector('select[aria-label=state]').options].map(o => o.textContent)"
        assert page.evaluate(choices) == ["all", "failed", "finished", "unfinished"]
        page.evaluate(put("state", "0"))
        assert page.evaluate(VISIBLE) == ["v2"]
        page.evaluate(put("state", ""))
        click = "[...document.querySelectorAll('#variants th button')].find(b => b.textContent === 'PDMS').click()"
        page.evaluate(click)
        assert page.evaluate(VISIBLE) == ["v1", "v0", "v2", "v3"], "what has no score comes last"
        page.evaluate(click)
        assert page.evaluate(VISIBLE)[:2] == ["v0", "v1"]
        assert page.evaluate("document.querySelector('th[aria-sort]').ariaSort") == "descending"
        assert page.evaluate("window.hacked") is None
        assert page.faults() == []
