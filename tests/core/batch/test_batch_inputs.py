"""Batches whose jobs, scenarios, logs and scenes lie at URLs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import fsspec
import pytest
from small_batch import batch, files, write_batch

from unisim_blender.core.batch.jobs import read_jobs
from unisim_blender.core.batch.plan import plan_batch
from unisim_blender.core.cli.main import run
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.scene_file import SceneHeader, write_scene_header
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.remote.copies import InputError
from unisim_blender.core.world.drive_json import drive_to_json

OPTIONS = ("--sensors", "front_camera")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, small_street: Path) -> Path:
    return write_batch(tmp_path_factory.mktemp("inputs"), small_street, formats=["png", "labels"])


@pytest.fixture
def url(folder: Path) -> str:
    """The same folder in a store in memory."""
    fs = fsspec.filesystem("memory")
    fs.put(f"{folder.as_posix()}/", f"/{folder.name}/", recursive=True)
    return f"memory://{folder.name}"


def test_a_sweep_at_a_url_makes_the_same_batch(folder: Path, url: str, tmp_path: Path) -> None:
    assert batch(folder / "sweep.json", tmp_path / "local", *OPTIONS) == 0
    assert batch(f"{url}/sweep.json", tmp_path / "remote", *OPTIONS) == 0
    there, mine = files(tmp_path / "remote"), files(tmp_path / "local")
    scenario = json.loads(there["variants/cars-0000/scenario.json"])
    assert scenario["log"] == f"{url}/street", "it is named by where it lies, not by its copy"
    assert {name: data for name, data in there.items() if not name.startswith("variants/")} == {
        name: data for name, data in mine.items() if not name.startswith("variants/")
    }
    with_lines = f"{url}/jobs.jsonl"
    fsspec.filesystem("memory").pipe_file(
        f"/{folder.name}/jobs.jsonl", b'{"scenario": "base.json", "set": {"/edits/0/pose/position/1": 2.0}}'
    )
    assert read_jobs([with_lines])[0].scenario == read_jobs([f"{url}/sweep.json"])[1].scenario
    assert read_jobs([f"{url}/street/"])[0].scenario.log == f"{url}/street"


def test_faults_name_the_url(folder: Path, url: str) -> None:
    fs = fsspec.filesystem("memory")
    fs.pipe_file(f"/{folder.name}/broken.json", b'{"format": "unisim-scenario", "version": 1, "name": "a"}')
    with pytest.raises(Exception, match=rf"{url}/broken\.json: .*log"):
        read_jobs([f"{url}/broken.json"])
    with pytest.raises(InputError, match=f"{url}/none.json: there is nothing there"):
        read_jobs([f"{url}/none.json"])
    fs.pipe_file(f"/{folder.name}/far.json", (folder / "base.json").read_bytes().replace(b'"street"', b'"nowhere"'))
    jobs = read_jobs([f"{url}/far.json"])
    with pytest.raises(InputError, match=f"{url}/nowhere: there is nothing there"):
        plan_batch(jobs, RenderOptions(renderer="surfel"))


def write_scene(folder: Path) -> None:
    drive = open_log(folder / "street").drive
    (folder / "scene").mkdir(exist_ok=True)
    header = SceneHeader(folder / "scene", "scene", "street", "../street", drive.world_origin, {}, {}, drive, {})
    write_scene_header(folder / "scene", header)


def test_of_a_log_beside_a_trained_scene_only_what_tells_its_drive_is_fetched(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(folder)
    fs = fsspec.filesystem("memory")
    fs.put(f"{folder.as_posix()}/", f"/lazy-{folder.name}/", recursive=True)
    fetched: list[str] = []
    get = type(fs).get_file

    def getting(self: Any, rpath: str, *args: Any, **options: Any) -> None:
        fetched.append(rpath)
        get(self, rpath, *args, **options)

    monkeypatch.setattr(type(fs), "get_file", getting)
    remote = prepare_scenario(f"memory://lazy-{folder.name}/scene")
    local = prepare_scenario(folder / "scene")
    assert drive_to_json(remote.edited) == drive_to_json(local.edited)
    assert len([name for name in fetched if name.endswith(".jpg")]) == 1, "which tells the images' size"
    assert not [name for name in fetched if "/lidar/" in name and name.endswith(".pkl.gz")]
    assert [name for name in fetched if "/cuboids/" in name]
    whole = prepare_scenario(f"memory://lazy-{folder.name}/street")
    assert files(whole.log_path) == files(folder / "street")


def test_render_and_drive_take_urls_too(folder: Path, tmp_path: Path) -> None:
    url = f"file://{folder.as_posix()}/base.json"
    more = (*OPTIONS, "--renderer", "surfel", "--quality", "fast")
    assert run(["render", url, "--out", str(tmp_path / "frames"), "--frames", "2", "--jobs", "1", *more]) == 0
    here = ["render", str(folder / "base.json"), "--out", str(tmp_path / "here"), "--frames", "2", "--jobs", "1", *more]
    assert run(here) == 0
    images = [files(tmp_path / name)["camera/front_camera/000002.png"] for name in ("frames", "here")]
    assert images[0] == images[1]
    assert run(["drive", url, "--driver", "constant", "--out", str(tmp_path / "driven"), *more]) == 0
    for name in ("simulated.json", "scenario.json"):
        written = json.loads((tmp_path / "driven" / name).read_bytes())
        assert written["log"] == f"file://{folder.as_posix()}/street"
