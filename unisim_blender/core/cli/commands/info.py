"""`unisim info`: what a recorded drive, a trained scene or a scenario holds."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...data.log import Log, extras_of
from ...data.values import doubts
from ...errors import LogError, UnisimError, short
from ...json_file import read_json
from ...world.classes import motion_of
from ...world.drive import Camera, Drive, Lidar
from ..options import PATH, boxes_option

if TYPE_CHECKING:
    from ...model.scene_file import SceneHeader
    from ...scenario.types import Scenario


@click.command()
@click.argument("path", type=PATH)
@boxes_option("path")
@click.option("--lamps", is_flag=True, help="Search a log's images for actors' lamps that change.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(path: Path, lamps: bool, as_json: bool) -> None:
    """Tell what PATH holds: a log, a trained scene (a folder), or a scenario (a JSON file)."""
    about = describe(path)
    if about["kind"] == "log":
        _add_agreement(path, about)
    if lamps:
        _add_lamps(path, about)
    click.echo(json.dumps(about, indent=2, ensure_ascii=False) if as_json else "\n".join(lines_of(about)))


def describe(path: Path) -> dict[str, Any]:
    """Return a description of ``path`` as a JSON object. Raises `UnisimError` where it is nothing of ours."""
    from ...formats.readers import open_log, reader_of
    from ...model.scene_file import FORMAT as SCENE_FORMAT
    from ...model.scene_file import HEADER_NAME, read_scene_header
    from ...scenario import FORMAT as SCENARIO_FORMAT
    from ...scenario import load_scenario

    if not path.exists():
        raise UnisimError(f"{path}: there is no such file or folder")
    if path.is_dir():
        if (path / HEADER_NAME).exists():
            return describe_scene(read_scene_header(path))
        return describe_log(open_log(path))
    if reader_of(path) is not None:
        return describe_log(open_log(path))
    document = read_json(path, UnisimError)
    kind = document.get("format") if isinstance(document, dict) else None
    if kind == SCENE_FORMAT:
        return describe_scene(read_scene_header(path))
    if kind == SCENARIO_FORMAT:
        return describe_scenario(load_scenario(path))
    raise UnisimError(f"{path}: is neither a log, a trained scene nor a scenario (its format is {short(kind)})")


def describe_log(log: Log) -> dict[str, Any]:
    """A recorded drive: frames, duration, sensors, actors by class, what is missing, and which values do not fit."""
    about = _about_drive("log", log.path, log.drive)
    for name, camera in about["cameras"].items():
        camera["images"] = len(log.image_frames(name))
    for name, lidar in about["lidars"].items():
        lidar["sweeps"] = len(log.sweep_frames(name))
    extras = extras_of(log)
    motion = {label: motion_of(label, extras.classes) for label in about["actors"]}
    sun = {} if extras.sun is None else {"sun": {name: round(x, 2) for name, x in asdict(extras.sun).items()}}
    return about | sun | {"motion": motion, "missing": list(log.missing), "doubts": doubts(log)}


def _add_agreement(path: Path, about: dict[str, Any]) -> None:
    """Add how well the sweeps of the log at ``path`` agree under its poses, and a doubt where they drift."""
    from ...formats.readers import open_log
    from ...poses.posed import measured

    try:
        report = measured(open_log(path))
    except LogError as fault:
        about["doubts"] = list(dict.fromkeys([*about["doubts"], str(fault)]))
        return
    about["poses"] = {"lidar": report.lidar, "lags": [asdict(row) for row in report.lags]}
    about["agreement"] = report.words if report.lidar else ""
    about["doubts"] += [f"{about['path']}: {report.doubt}"] if report.doubt else []


def _add_lamps(path: Path, about: dict[str, Any]) -> None:
    """Add what the images of the log at ``path`` show of actors' lamps. Raises `UnisimError` where it is no log."""
    from ...actor_images.lamps import lamps_in
    from ...formats.readers import open_log
    from ...progress import Bar

    if about["kind"] != "log":
        raise UnisimError(f"{path}: is a {about['kind']}: --lamps looks at a log's images")
    log = open_log(path)
    with Bar(total=100, unit="%", desc="lamps", delay=0.5) as bar:
        by_actor = lamps_in(log, lambda share: bar.update(round(100 * share) - bar.n))
    about["lamps"] = []
    for uid, lamp in ((uid, lamp) for uid, some in by_actor.items() for lamp in some):
        spans = zip(lamp.shown, lamp.times_s, strict=True)
        words = ", ".join(f"{lamp.states[state]} from {time_s:.1f} s" for state, time_s in spans)
        about["lamps"].append(f"{uid} {lamp.name}: {words} (certain to {100 * lamp.certainty:.0f} %)")


def describe_scene(header: SceneHeader) -> dict[str, Any]:
    """A trained scene: its drive, what it was trained on and how, and the size of its weights."""
    from ...model.scene_file import WEIGHTS_NAME

    weights = header.path / WEIGHTS_NAME
    present = weights.is_file()
    return _about_drive("trained scene", header.path, header.drive) | {
        "name": header.name,
        "trained_on": {"log": header.log_name, "path": header.log_path},
        "training": {
            key: value for key, value in header.training.items() if isinstance(value, str | int | float | bool)
        },
        "weights_mb": round(weights.stat().st_size / 1e6, 1) if present else 0.0,
        "missing": [] if present else [f"{weights} is missing"],
    }


def describe_scenario(scenario: Scenario) -> dict[str, Any]:
    """A scenario: its log and scene, its edits by type, what its meshes' files hold that is left out or doubted, and which
    of its files are missing."""
    from ...remote.requests import is_url
    from ...scenario.types import FrameRange

    wanted = [path for path in (scenario.log_path, scenario.scene_path) if path is not None]
    meshes = dict.fromkeys(
        scenario.resolve(name)
        for edit in scenario.edits
        for name in (getattr(edit, member) for member in edit.meshes)
        if not is_url(name)
    )
    return {
        "kind": "scenario",
        "path": str(scenario.path),
        "name": scenario.name,
        "log": str(scenario.log_path),
        "scene": scenario.scene,
        "frames": asdict(scenario.frames) if isinstance(scenario.frames, FrameRange) else scenario.frames,
        "edits": dict(sorted(Counter(edit.type for edit in scenario.edits).items())),
        "meshes": [note for path in meshes if path.exists() for note in _about_mesh(path)],
        "missing": [f"{path} is missing" for path in (*wanted, *meshes) if not path.exists()],
    }


def _about_mesh(path: Path) -> tuple[str, ...]:
    from ...meshes.read import mesh_notes

    try:
        return mesh_notes(path)
    except UnisimError as fault:
        return (str(fault),)


def _about_drive(kind: str, path: Path, drive: Drive) -> dict[str, Any]:
    actors: dict[str, dict[str, int]] = {}
    for actor in sorted(drive.actors.values(), key=lambda actor: actor.label):
        count = actors.setdefault(actor.label, {"moving": 0, "still": 0})
        count["moving" if actor.is_moving else "still"] += 1
    return {
        "kind": kind,
        "path": str(path),
        "name": drive.name,
        "frames": list(drive.frames),
        "duration_s": round(drive.duration_s, 3),
        "cameras": {name: _about_camera(camera) for name, camera in drive.cameras.items()},
        "lidars": {name: _about_lidar(lidar) for name, lidar in drive.lidars.items()},
        "actors": actors,
    }


def _about_camera(camera: Camera) -> dict[str, Any]:
    model = camera.model
    return {"width": model.width, "height": model.height, "rolling_shutter_s": model.shutter.duration_s}


def _about_lidar(lidar: Lidar) -> dict[str, Any]:
    return {"beams": lidar.model.beams, "columns": lidar.model.columns if lidar.model.beams else 0}


def lines_of(about: dict[str, Any]) -> list[str]:
    """The description in words."""
    lines = [f"{about['kind']} {about['name']}: {about['path']}"]
    if about["kind"] == "scenario":
        lines += [f"  log: {about['log']}", f"  scene: {about['scene'] or 'none'}"]
        lines += [f"  edits: {', '.join(f'{count} {kind}' for kind, count in about['edits'].items()) or 'none'}"]
    else:
        lines += _lines_of_drive(about)
    if about.get("meshes"):
        lines += ["  meshes:", *(f"    {sentence}" for sentence in about["meshes"])]
    if "trained_on" in about:
        lines.append(f"  trained on: {about['trained_on']['log']} ({about['trained_on']['path']})")
        lines += [f"  {key}: {value}" for key, value in about["training"].items()]
        lines.append(f"  weights: {about['weights_mb']} MB")
    lines += [f"  poses: {about['agreement']}"] if about.get("agreement") else []
    if sun := about.get("sun"):
        where = "azimuth {azimuth_deg:.1f}, elevation {elevation_deg:.1f} degrees, within {deviation_deg:.1f}"
        lines.append(f"  sun: {where.format(**sun)}, by place and time, whether it shone or not")
    if "lamps" in about:
        lines += ["  lamps:", *(f"    {sentence}" for sentence in about["lamps"])]
        lines.append("    all others are seen in one state" if about["lamps"] else "    each is seen in one state")
    lines.append("  missing:" if about["missing"] else "  missing: nothing")
    lines += [f"    {sentence}" for sentence in about["missing"]]
    if about.get("doubts"):
        lines += ["  doubts:", *(f"    {sentence}" for sentence in about["doubts"])]
    return lines


def _lines_of_drive(about: dict[str, Any]) -> list[str]:
    frames = about["frames"]
    lines = [f"  {len(frames)} frames ({frames[0]} to {frames[-1]}), {about['duration_s']:.1f} s"]
    for name, camera in about["cameras"].items():
        images = f", {camera['images']} images" if "images" in camera else ""
        lines.append(f"  camera {name}: {camera['width']} x {camera['height']}{images}")
    for name, lidar in about["lidars"].items():
        beams = (
            f"{lidar['beams']} beams x {lidar['columns']} columns" if lidar["beams"] else "plain points, no beam table"
        )
        sweeps = f", {lidar['sweeps']} sweeps" if "sweeps" in lidar else ""
        lines.append(f"  lidar {name}: {beams}{sweeps}")
    total = sum(count["moving"] + count["still"] for count in about["actors"].values())
    lines.append(f"  {total} actors" + (":" if total else ""))
    for label, count in about["actors"].items():
        parts = [f"{count[state]} {state}" for state in ("moving", "still") if count[state]]
        lines.append(f"    {label}: {', '.join(parts)}")
    return lines
