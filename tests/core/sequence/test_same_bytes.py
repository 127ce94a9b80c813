"""A frame's bytes depend on that frame alone: not on the frames beside it, on processes or threads, nor on what is
there at other times.

Each commit is held against itself. Digests of outputs are not stored: numpy and its linear algebra choose their own
instructions by the processor, so the same digests do not hold on two machines. `tools/compare_bytes.py` compares two
commits, with the scenarios and the comparison that are used here.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from instruction_sets import run_with
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core import native
from unisim_blender.core.colour import bytes_from_srgb
from unisim_blender.core.prepare.capture_request import capture_request
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.worker.server import Jobs

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))

from byte_checks.difference import differences, files_of  # noqa: E402
from byte_checks.inputs import write_inputs  # noqa: E402

pytestmark = pytest.mark.skipif(native.library() is None, reason="plain torch would take minutes")
FRAME = "9"
SMALL = ("--width", "96", "--quality", "fast")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scenarios on the sample's scene; ``busy`` has every type of edit."""
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder, ROOT / "sample" / "scene", folder / "no log")
    return folder


@pytest.fixture(scope="module")
def alone(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One frame of ``busy``, rendered by itself."""
    return render(inputs / "busy.json", tmp_path_factory.mktemp("alone") / "frames", "--frames", FRAME)


def render(scenario: Path, out: Path, *more: str) -> Path:
    """In a process of its own: nothing is left of what was rendered before."""
    asked = ["render", str(scenario), "--out", str(out), "--jobs", "1", *SMALL, *more]
    command = [
        sys.executable,
        "-c",
        "import sys; from unisim_blender.core.cli.main import run; sys.exit(run(sys.argv[1:]))",
        *asked,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return out


def unlike(a: Path, b: Path) -> list[str]:
    """Differences of the files that both folders have; manifests and drives list all frames."""
    both = {*files_of(a)} & {*files_of(b)} - {"manifest.json", "drive.json"}
    assert sum(FRAME.zfill(6) in name for name in both) >= 7
    return [str(difference) for difference in differences(a, b) if difference.file in both]


def edited(inputs: Path, name: str, **more: Any) -> Path:
    """A copy of ``busy`` with other members, and edits after its own."""
    document = json.loads((inputs / "busy.json").read_text())
    edits = [*document["edits"], *more.pop("edits", ())]
    (inputs / f"{name}.json").write_text(json.dumps({**document, **more, "edits": edits}))
    return inputs / f"{name}.json"


@pytest.mark.parametrize("more", [("--frames", "1:12:4"), ("--frames", "5:13:4", "--jobs", "3"), ("--frames", "9,3")])
def test_frames_beside_it_change_no_byte(inputs: Path, alone: Path, tmp_path: Path, more: tuple[str, ...]) -> None:
    assert unlike(alone, render(inputs / "busy.json", tmp_path / "out", *more)) == []


@pytest.mark.parametrize("name", ["portable", "avx2", "avx512"])
def test_threads_change_no_byte(inputs: Path, tmp_path: Path, name: str) -> None:
    """With the kernels of each instruction set."""
    some = ("--frames", FRAME, "--sensors", "front_camera,few", "--width", "48")
    script = f"""
import os, sys
from unisim_blender.core.cli.main import run
for threads in ("1", "3"):
    os.environ["OMP_NUM_THREADS"] = threads
    asked = ["render", sys.argv[1], "--out", sys.argv[2] + threads, "--jobs", "1", *{SMALL!r}, *{some!r}]
    assert run(asked) == 0
"""
    run_with(name, script, inputs / "busy.json", tmp_path / "of")
    assert [str(difference) for difference in differences(tmp_path / "of1", tmp_path / "of3")] == []
    manifest = json.loads((tmp_path / "of1" / "manifest.json").read_bytes())
    assert manifest["environment"]["instruction_set"] == name


def test_a_scenario_of_one_frame_has_the_whole_drives_bytes(inputs: Path, alone: Path, tmp_path: Path) -> None:
    """Though a drive that ends earlier has other ends."""
    short = edited(inputs, "short", frames=[7, 9, 11])
    found = [x for x in unlike(alone, render(short, tmp_path / "out", "--frames", FRAME)) if ".state" not in x]
    assert found == []


LATER = {"start_s": 1.5, "end_s": 1.9}


@pytest.mark.parametrize(
    "edit",
    [
        {"type": "duplicate", "actor": "cone-3", "id": "z-later", "world_offset_m": [0, 3, 0], "present": LATER},
        {"type": "insert_mesh", "mesh": "block.ply", "id": "z-later", "label": "Car", "present": LATER,
         "pose": {"position": [15.0, 1.0, 0.7], "yaw_deg": 0}},
    ],
    ids=["actor", "mesh"],
)  # fmt: skip
def test_what_comes_later_changes_no_number(inputs: Path, alone: Path, tmp_path: Path, edit: dict[str, Any]) -> None:
    """An actor more moves the numbers of instances behind its own; nothing else of a frame in which it is not there."""
    out = render(edited(inputs, f"later-{edit['type']}", edits=[edit]), tmp_path / "out", "--frames", FRAME)
    for camera in ("front_camera", "roadside"):
        before, after = (channels(folder / "camera" / camera / f"{FRAME.zfill(6)}.exr") for folder in (alone, out))
        assert before.keys() == after.keys() and {"R", "depth", "normal.X", "opacity", "unsupported"} <= before.keys()
        for name in before.keys() - {"instance"}:
            assert before[name].tobytes() == after[name].tobytes(), (camera, name)
        assert np.array_equal(before["instance"] > 0, after["instance"] > 0)
    sweeps = [dict(np.load(folder / "lidar" / "few" / f"{FRAME.zfill(6)}.npz")) for folder in (alone, out)]
    for name in ("x", "y", "z", "intensity"):
        values = [sweep[name] if name in sweep else sweep["points"][name] for sweep in sweeps]
        assert len(values[0]) > 100 and values[0].tobytes() == values[1].tobytes(), name
    assert (alone / "labels" / f"{FRAME.zfill(6)}.json").read_bytes() == (
        out / "labels" / f"{FRAME.zfill(6)}.json"
    ).read_bytes()


def test_what_is_there_does_change_the_frame(inputs: Path, alone: Path, tmp_path: Path) -> None:
    """The same actor now: else the tests above could not fail."""
    edit = {"type": "duplicate", "actor": "cone-3", "id": "z-now", "world_offset_m": [0, 1.5, 0]}
    found = unlike(alone, render(edited(inputs, "now", edits=[edit]), tmp_path / "out", "--frames", FRAME))
    assert {f"camera/front_camera/{FRAME.zfill(6)}.exr", f"lidar/few/{FRAME.zfill(6)}.npz"} <= {
        x.partition(":")[0] for x in found
    }


@pytest.mark.parametrize("region", [None, (20, 10, 70, 41)], ids=["bands", "region"])
def test_the_workers_image_has_the_command_lines_bytes(
    inputs: Path, alone: Path, tmp_path: Path, region: tuple[int, int, int, int] | None
) -> None:
    """Whole in bands, or a part of it; at the same time, without the frame's number."""
    path, camera = inputs / "busy.json", "front_camera"
    prepared = prepare_scenario(path)
    recorded, scene = prepared.edited.cameras[camera], prepared.scene
    assert scene is not None
    seen_by, log = recorded.resized(96), prepared.scenario.log_path
    model, parked, time_s = seen_by.model, scene.header.parked, recorded.time_s[int(FRAME)]
    left, top, right, bottom = region or (0, 0, model.width, model.height)
    request = {
        **capture_request(prepared.edited, parked, seen_by, time_s, log, scene.path),
        "passes": ["rgb", "depth", "instance"], "quality": "fast", "shadows": True,
        "rows": [top, bottom], "columns": [left, right],
        "coarse": [8] if region is None else [],
    }  # fmt: skip
    shown = {name: np.full((model.height, model.width), np.nan) for name in ("depth", "instance")}
    shown["rgb"] = np.full((model.height, model.width, 3), np.nan)
    for event in Jobs(tmp_path).camera(request):
        assert event["event"] == "arrays"
        if tuple(event["stride"]) != (1, 1):
            continue
        (first, last), (begin, end) = event["rows"], event["columns"]
        data = (tmp_path / event["file"]).read_bytes()
        for name, array in shown.items():
            place = event["arrays"]["depth_m" if name == "depth" else name]
            values = np.frombuffer(data, place["dtype"], int(np.prod(place["shape"])), place["offset"])
            array[first:last, begin:end] = values.reshape(place["shape"])
    inner = slice(top, bottom), slice(left, right)
    file = alone / "camera" / camera / FRAME.zfill(6)
    whole = channels(file.with_suffix(".exr"))
    for name in ("depth", "instance"):
        assert np.array_equal(shown[name][inner], whole[name][inner]), name
    with Image.open(file.with_suffix(".png")) as image:
        assert np.array_equal(bytes_from_srgb(shown["rgb"][inner].astype(np.float32)), np.asarray(image)[inner])


def channels(file: Path) -> dict[str, NDArray[Any]]:
    stored = OpenEXR.File(str(file), separate_channels=True)
    return {name: channel.pixels for name, channel in stored.channels().items()}
