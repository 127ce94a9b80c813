"""Every reader of files, with files that are whole and how they are changed."""

from __future__ import annotations

import gzip
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from random_scene import CARS, edited
from small_log import write_small_log
from stress.scenes import make_scene
from turning_drive import turning_drive

from unisim_blender.core import native
from unisim_blender.core.cli.commands.info import describe_log, describe_scene, lines_of
from unisim_blender.core.data import open_log
from unisim_blender.core.data.safe_pickle import Table, read_table
from unisim_blender.core.data.table_file import table_pickle
from unisim_blender.core.meshes.intersect import Mesh
from unisim_blender.core.meshes.read import read_mesh
from unisim_blender.core.metrics.document import read_outputs
from unisim_blender.core.metrics.measure import measure
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.scene_file import HEADER_NAME, WEIGHTS_NAME, read_scene_header
from unisim_blender.core.model.weights import read_weights
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.rigs import built_in_rigs, read_rig
from unisim_blender.core.scenario import apply_scenario, load_scenario
from unisim_blender.core.street.street import Recipe, load_street, recipe_document
from unisim_blender.core.world.drive import Actor

from .changes import ODD, Random, changed_array, changed_bytes, changed_json, json_text


@dataclass(frozen=True)
class Reader:
    """``change`` writes a changed file, ``read`` reads it; a refusal holds one of ``names``."""

    change: Callable[[Random], None]
    read: Callable[[], object]
    names: tuple[str, ...]


Maker = Callable[[Path], Reader]


def _json(file: Path, document: Any, read: Callable[[], object], *names: str) -> Reader:
    return Reader(lambda rng: _write(file, json_text(changed_json(document, rng), rng)), read, names or (file.name,))


def _write(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)


KEYS = [{"time_s": 0.2, "position": [1, 2, 3], "yaw_deg": 0}, {"frame": 6, "position": [5, 2, 3], "yaw_deg": 90}]
STANDS = {"position": [1.0, 2.0, 0.5], "yaw_deg": 20.0}
SCENARIO: dict[str, Any] = {
    "format": "unisim-scenario", "version": 1, "name": "all", "log": "log", "frames": {"start": 0, "stop": 9, "step": 2},
    "boxes": {"bin": {"position": [1, 1, 1], "size_m": [1, 2, 3], "quaternion_wxyz": [1, 0, 0, 0]}},
    "sensors": {
        "cameras": [
            {"id": "front", "width": 32, "shutter": {"duration_s": 0.01}},
            {"id": "side", "like": "front", "mount": STANDS},
        ],
        "lidars": [
            {"id": "top", "mount_offset": {"position": [0, 0, 1], "pitch_deg": 3}},
            {"id": "roof", "elevation_deg": [1, 0, -1], "columns": 90, "trajectory": KEYS},
        ],
    },
    "edits": [
        {"type": "duplicate", "actor": "car", "id": "a", "offset_m": [1, 0, 0], "time_offset_s": 0.1},
        {"type": "duplicate", "actor": "late", "id": "b", "trajectory": KEYS, "outside": "hold"},
        {"type": "insert", "actor": "bus", "id": "c", "scene": "other", "pose": STANDS, "present": {"start_s": 0.1}},
        {"type": "insert_mesh", "mesh": "thing.npz", "id": "d", "label": "Cone", "trajectory": KEYS},
        {"type": "ego_body", "mesh": "thing.npz", "id": "e", "mount": STANDS},
        {"type": "move", "actor": "van", "trajectory": KEYS},
        {"type": "retime", "actor": "car", "map": [[0, 0], [0.5, 0.2], [1, 0.9]]},
        {"type": "retime", "actor": "late", "speed": 0.5, "pivot_s": 0.4, "offset_s": 0.1},
        {"type": "swap", "actor": "van", "look": "car"},
        {"type": "scale", "actor": "car", "factors": [1.2, 1.0, 0.9]},
        {"type": "copy_static", "box": "bin", "id": "f", "target": STANDS},
        {"type": "remove_static", "box": "bin"},
        {"type": "remove", "actor": "late"},
        {"type": "ego", "shift": [{"time_s": 0.1, "left_m": 0}, {"frame": 8, "left_m": 1.5}]},
        {"type": "ego", "trajectory": KEYS},
    ],
    "outputs": {"passes": ["rgb", "depth"], "formats": ["png", "npz"], "width": 64, "quality": "fast", "contact_shadows": True},
}  # fmt: skip


def _other_scene(path: Path) -> dict[str, Actor]:
    van = turning_drive().actors["van"]
    return {"bus": replace(van, uid="bus", size_m=np.array([11.0, 2.5, 3.0]))}


def scenario(folder: Path) -> Reader:
    """A scenario of every edit, and its edits applied."""
    file, drive = folder / "scenario.json", turning_drive()
    _mesh_arrays(folder / "thing.npz", trimesh.creation.box([2, 1, 1]))
    return _json(file, json.loads(json.dumps(SCENARIO)), lambda: apply_scenario(load_scenario(file), drive, _other_scene))


def scene_header(folder: Path) -> Reader:
    """`scene.json` alone, and what is told of it."""
    file = make_scene(folder / "scene", edited(CARS)) / HEADER_NAME
    document = json.loads(file.read_text())
    return _json(file, document, lambda: lines_of(describe_scene(read_scene_header(file))))


def _scene(folder: Path, read: Callable[[Path], object]) -> Reader:
    """Both files of a trained scene, one of them changed."""
    made = make_scene(folder / "scene", edited(CARS))
    header, weights = made / HEADER_NAME, made / WEIGHTS_NAME
    document = json.loads(header.read_text())
    document["weights"] = ""  # or no change of the weights would be looked at
    raw = weights.read_bytes()
    length = int.from_bytes(raw[:8], "little")
    names, data = json.loads(raw[8 : 8 + length]), raw[8 + length :]

    def change(rng: Random) -> None:
        kind = int(rng.integers(4))
        part = str(rng.choice(["model", "volume", "training", "drive"])) if kind < 2 else ""
        told = {**document, part: changed_json(document[part], rng)} if part else document
        header.write_bytes(json_text(told, rng))
        if kind == 2:
            listed = json_text(changed_json(names, rng), rng)
            weights.write_bytes(len(listed).to_bytes(8, "little") + listed + data)
        elif kind == 3:
            weights.write_bytes(changed_bytes(raw, rng))
        else:
            weights.write_bytes(raw)

    return Reader(change, lambda: read(made), (HEADER_NAME, WEIGHTS_NAME, made.name))


def scene_for_kernels(folder: Path) -> Reader:
    """A trained scene as the compiled tracer opens it."""
    return _scene(folder, CompiledScene)


def scene_for_torch(folder: Path) -> Reader:
    """A trained scene as torch opens it."""
    return _scene(folder, load_scene)


def weights(folder: Path) -> Reader:
    """A small safetensors file, every array of it looked at."""
    file = folder / WEIGHTS_NAME
    arrays: dict[str, NDArray[Any]] = {
        "a": np.arange(6, dtype=np.float32).reshape(2, 3),
        "b": np.zeros(3, np.float16),
        "c": np.ones((), np.int64),
    }
    listed, data = {}, b""
    for name, array in arrays.items():
        kind = {"float32": "F32", "float16": "F16", "int64": "I64"}[array.dtype.name]
        listed[name] = {"dtype": kind, "shape": list(array.shape), "data_offsets": [len(data), len(data) + array.nbytes]}
        data += array.tobytes()

    def change(rng: Random) -> None:
        head = json_text(changed_json(listed, rng) if rng.random() < 0.7 else listed, rng)
        whole = len(head).to_bytes(8, "little") + head + data
        file.write_bytes(changed_bytes(whole, rng) if rng.random() < 0.4 else whole)

    def read() -> object:
        found = read_weights(file)
        return [found.array(name, array.shape) for name, array in found.arrays.items()]

    return Reader(change, read, (file.name,))


def checkpoint(folder: Path) -> Reader:
    """A training's checkpoint."""
    from safetensors.torch import load_file, save_file

    from unisim_blender.core.training.config import TrainConfig
    from unisim_blender.core.training.run import load_checkpoint, save_checkpoint
    from unisim_blender.core.training.trainer import Trainer

    write_small_log(folder / "log")
    log = open_log(folder / "log")
    config = TrainConfig(
        cameras=("front_camera",), lidars=("pandar64",), frames=(0, 2), width=None, preset="tiny", minutes=None, iterations=3
    )
    trainer = Trainer(log, config)
    trainer.step()
    file, whole = folder / "checkpoint.safetensors", folder / "whole.safetensors"
    save_checkpoint(whole, trainer)
    raw, tensors = whole.read_bytes(), load_file(whole)
    length = int.from_bytes(raw[:8], "little")
    listed = json.loads(raw[8 : 8 + length])

    def change(rng: Random) -> None:
        kind = int(rng.integers(4))
        if kind == 0:
            file.write_bytes(changed_bytes(raw, rng))
        elif kind == 1:
            head = json_text(changed_json(listed, rng), rng)
            file.write_bytes(len(head).to_bytes(8, "little") + head + raw[8 + length :])
        else:
            changed, name = dict(tensors), str(rng.choice(sorted(tensors)))
            value = changed[name]
            about = dict(listed["__metadata__"])
            if kind == 2:
                changed[name] = [value[None], value.reshape(-1)[:-1], value.double(), value.int(), value.reshape(-1)][
                    rng.integers(5)
                ]
                changed[name] = changed[name].contiguous().clone()
            else:
                del changed[name]
                if rng.random() < 0.5:
                    about[str(rng.choice(sorted(about)))] = str(ODD[rng.integers(len(ODD))]).replace("\ud800", "")
                    changed = dict(tensors)
                elif rng.random() < 0.5:
                    changed[str(rng.choice(["x", "adam.x.y", "adam.99999.step", "held.0", f"{name}.x", name.split(".")[0]]))] = (
                        value
                    )
            save_file(changed, file, metadata=about)

    return Reader(change, lambda: load_checkpoint(file, trainer), (file.name,))


def log_text(folder: Path) -> Reader:
    """A log of which one JSON file is changed, opened and read through."""
    write_small_log(folder / "log")
    files = sorted((folder / "log").rglob("*.json"))
    return _log(folder / "log", files, lambda data, rng: json_text(changed_json(json.loads(data), rng), rng))


def log_tables(folder: Path) -> Reader:
    """A log of which one table is changed, or another file's bytes."""
    write_small_log(folder / "log")
    files = sorted(path for path in (folder / "log").rglob("*") if path.suffix in (".gz", ".jpg"))

    def changed(data: bytes, rng: Random) -> bytes:
        if data[:2] != b"\x1f\x8b":
            return changed_bytes(data, rng)
        return _changed_table(data, folder / "table.pkl.gz", rng)

    return _log(folder / "log", files, changed)


def log_of_pandaset(folder: Path) -> Reader:
    """A log without a file of ours, which is read as PandaSet's own."""
    write_small_log(folder / "log")
    (folder / "log" / "meta" / "unisim.json").unlink()
    files = sorted(path for path in (folder / "log").rglob("*") if path.suffix in (".gz", ".json"))

    def changed(data: bytes, rng: Random) -> bytes:
        if data[:2] == b"\x1f\x8b":
            return _changed_table(data, folder / "table.pkl.gz", rng)
        return json_text(changed_json(json.loads(data), rng), rng)

    return _log(folder / "log", files, changed)


def _log(path: Path, files: list[Path], changed: Callable[[bytes, Random], bytes]) -> Reader:
    whole = {file: file.read_bytes() for file in files}
    last: list[Path] = []

    def change(rng: Random) -> None:
        for file in last:
            _write(file, whole[file])
        last[:] = [files[rng.integers(len(files))]]
        if rng.random() < 0.02:
            last[0].unlink()
        else:
            last[0].write_bytes(changed(whole[last[0]], rng))

    def read() -> object:
        log = open_log(path)
        lines_of(describe_log(log))
        for name in log.drive.cameras:
            for frame in log.image_frames(name)[:2]:
                log.image(name, frame)
        for name, lidar in log.drive.lidars.items():
            for frame in log.sweep_frames(name)[:2]:
                log.sweep_grid(name, frame) if lidar.model.beams else log.sweep(name, frame)
        return log

    return Reader(change, read, (path.name,))


def _changed_table(data: bytes, scratch: Path, rng: Random) -> bytes:
    """A gzipped table with a column changed, or bytes of its pickle, or of the whole."""
    kind = int(rng.integers(5))
    if kind == 0:
        return changed_bytes(data, rng)
    if kind == 1:
        return gzip.compress(changed_bytes(gzip.decompress(data), rng), 1)
    scratch.write_bytes(data)
    table: Table = dict(read_table(scratch))
    name = str(rng.choice(sorted(table)))
    if kind == 2:
        del table[name]
        return gzip.compress(table_pickle(table), 1)
    column = np.array(table[name])
    if kind == 3:
        column = column.astype(object)
    try:
        table[name] = changed_array(column, rng)
        return gzip.compress(table_pickle(table), 1)
    except (ValueError, TypeError, IndexError, OverflowError, UnicodeEncodeError):  # the writer takes no such column
        return changed_bytes(data, rng)


def table(folder: Path) -> Reader:
    """The pickle of a table, its bytes changed."""
    file = folder / "table.pkl.gz"
    content = {"x": np.arange(5.0), "n": np.arange(5), "s": np.array(["a", "b", "", "d", None], object), "b": np.ones(5, bool)}
    raw = table_pickle(content)

    def change(rng: Random) -> None:
        data = gzip.compress(changed_bytes(raw, rng), 1)
        file.write_bytes(changed_bytes(data, rng) if rng.random() < 0.1 else data)

    return Reader(change, lambda: read_table(file, ("x",)), (file.name,))


def _mesh_arrays(file: Path, mesh: trimesh.Trimesh) -> dict[str, Any]:
    faces = np.asarray(mesh.faces, np.int32)
    n = len(faces)
    arrays = {
        "vertices": np.asarray(mesh.vertices, np.float32), "faces": faces, "texture": np.array([0] + [-1] * (n - 1), np.int32),
        "normals": np.repeat(np.asarray(mesh.face_normals, np.float32)[:, None], 3, 1), "uv": np.zeros((n, 3, 2), np.float32),
        "colours": np.full((n, 3, 3), 0.5, np.float32), "texture_0": np.zeros((2, 2, 3), np.uint8),
    }  # fmt: skip
    np.savez(file, **arrays)
    return arrays


def mesh_arrays(folder: Path) -> Reader:
    """Our own file of a mesh."""
    file = folder / "mesh.npz"
    arrays = _mesh_arrays(file, trimesh.creation.box([2, 1, 1]))
    raw = file.read_bytes()

    def change(rng: Random) -> None:
        kind = int(rng.integers(6))
        if kind == 0:
            file.write_bytes(changed_bytes(raw, rng))
            return
        changed, name = dict(arrays), str(rng.choice(sorted(arrays)))
        if kind == 1:
            del changed[name]
        else:
            changed[name] = changed_array(arrays[name], rng)
        np.savez(file, **changed)

    return Reader(change, lambda: _met(file), (file.name,))


def _met(file: Path) -> object:
    return Mesh(read_mesh(file)).first_hits(np.array([[-9.0, 0, 0]]), np.array([[1.0, 0, 0]]), 0.0)


def mesh_files(folder: Path) -> Reader:
    """Meshes as others write them: text and bytes changed."""
    box = trimesh.creation.box([2, 1, 1])
    painted = box.copy()
    painted.visual.vertex_colors = np.full((8, 4), 200, np.uint8)
    textured = box.copy()
    visual: Any = trimesh.visual
    material = visual.material.SimpleMaterial(image=Image.new("RGB", (2, 2)))
    textured.visual = visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    whole: list[tuple[str, bytes]] = []
    for suffix, mesh, options in (
        ("ply", painted, {"encoding": "ascii"}), ("ply", painted, {}), ("obj", box, {}), ("stl", box, {}), ("off", box, {}),
        ("glb", textured, {}), ("glb", painted, {}),
    ):  # fmt: skip
        data = mesh.export(file_type=suffix, **options)
        whole.append((suffix, data.encode() if isinstance(data, str) else data))
    whole += [("ply", _ply(faces)) for faces in ("4 0 1 2 3", "3 0 1 9", "3 0 1 -1", "2 0 1", "3 0 0 0", "3 1 2 nan")]
    whole.append(("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\nf 1/1/1 2 3\n"))
    last: list[Path] = [folder / "none"]

    def change(rng: Random) -> None:
        suffix, data = whole[rng.integers(len(whole))]
        last[0].unlink(missing_ok=True)
        last[0] = folder / f"mesh.{suffix}"
        kind = int(rng.integers(4))
        if kind == 0 and suffix in ("ply", "obj", "off") and data.isascii():
            words = data.split(b" ")
            words[rng.integers(len(words))] = str(rng.choice(["nan", "-1", "1e40", "99999999999", "x", "", "inf", "9"])).encode()
            data = b" ".join(words)
        elif kind == 1 and suffix == "glb":
            length = int.from_bytes(data[12:16], "little")
            text = json.dumps(changed_json(json.loads(data[20 : 20 + length]), rng)).encode("utf-8", "surrogatepass")
            text += b" " * (-len(text) % 4)
            rest = data[20 + length :]
            total = (12 + 8 + len(text) + len(rest)).to_bytes(4, "little")
            data = data[:8] + total + len(text).to_bytes(4, "little") + data[16:20] + text + rest
        elif rng.random() < 0.9:
            data = changed_bytes(data, rng)
        last[0].write_bytes(data)

    return Reader(change, lambda: _met(last[0]), ("mesh.",))


def _ply(faces: str) -> bytes:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    lists = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    return f"{head}{lists}0 0 0\n1 0 0\n0 1 0\n0 0 1\n{faces}\n".encode()


def rig(folder: Path) -> Reader:
    """A rig of every member."""
    file = folder / "rig.json"
    document = json.loads(built_in_rigs()[0].read_text())
    return _json(file, document, lambda: read_rig(file))


def metrics(folder: Path) -> Reader:
    """Outputs of an autonomy stack, compared with themselves."""
    file = folder / "outputs.json"
    box = {
        "box": [10, 2, 4, 2, 0.1],
        "score": 0.9,
        "class": "Car",
        "modes": [{"probability": 1.0, "positions": [[1, 2], [3, 4]]}],
    }
    frame = {"sequence": "001", "frame": 0, "boxes": [box, {**box, "ignored": True}], "plan": [[0, 1], [2, 3]]}
    document = {"format": "unisim-autonomy", "version": 1, "boxes": "bev", "frames": [frame, {**frame, "frame": 1}]}

    def read() -> object:
        outputs = read_outputs(file)
        return measure(outputs, outputs)

    return _json(file, document, read)


def street_recipe(folder: Path) -> Reader:
    """A street's recipe, which is small, and the street of it."""
    file = folder / "street.json"
    document = recipe_document(Recipe(frames=2, width=16, height=16))
    return _json(file, document, lambda: load_street(file))


def image(folder: Path) -> Reader:
    """A recorded image, its bytes changed."""
    write_small_log(folder / "log")
    log = open_log(folder / "log")
    file = log.image_path("front_camera", 1)
    assert file is not None
    raw = file.read_bytes()
    progressive = io.BytesIO()
    Image.open(file).save(progressive, "JPEG", progressive=True)
    others = (raw, progressive.getvalue())
    return Reader(
        lambda rng: _write(file, changed_bytes(others[rng.integers(2)], rng)),
        lambda: log.image("front_camera", 1),
        (file.name,),
    )


def render_record(folder: Path) -> Reader:
    """What a folder of rendered frames says of itself: a record that is broken counts as none, and names no file elsewhere."""
    from unisim_blender.core.sequence.records import STATE_FOLDER, read_records, remove_files
    from unisim_blender.core.sequence.run import _read_timings

    out, precious = folder / "out", folder / "precious"
    file = out / STATE_FOLDER / "000001.json"
    files = {"a.png": "0" * 64, "../precious": "x"}
    camera = {"identity": "k", "files": files, "sees": ["car"], "samples": {"rays": 1}, "max_error": None}
    document = {"frame": 1, "captures": {"camera/a": camera, "labels": {**camera, "files": {"a.json": "0" * 64}}}}

    def change(rng: Random) -> None:
        shutil.rmtree(out, ignore_errors=True)
        precious.write_text("mine")
        _write(file, json_text(changed_json(document, rng), rng))
        _write(out / "timings.json", json_text(changed_json({"1": {"a": 0.1}}, rng), rng))

    def read() -> object:
        found = read_records(out), _read_timings(out)
        for captures in found[0].values():
            for record in captures.values():
                record.is_whole(out)
                remove_files(out, record)
        assert precious.is_file(), "a file beside the folder was removed"
        return found

    return Reader(change, read, (file.name,))


READERS: dict[str, Maker] = {
    "scenario": scenario, "scene.json": scene_header, "scene for torch": scene_for_torch, "weights": weights,
    "checkpoint": checkpoint, "log: JSON": log_text, "log: tables and images": log_tables, "log of PandaSet": log_of_pandaset,
    "table": table, "mesh: own": mesh_arrays, "mesh: others": mesh_files, "rig": rig, "metrics": metrics, "image": image,
    "street": street_recipe,
    "render record": render_record,
    **({} if native.library() is None else {"scene for kernels": scene_for_kernels}),
}  # fmt: skip
