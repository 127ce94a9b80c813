"""Drive a real Blender window through its sessions and check what came of them. Needs root: Blender lives in a
folder of its own.

python tests/ui/run.py ROOT RELEASE OUT [SESSION ...]   (ROOT: where that Debian is or will be; RELEASE: trixie or sid)
    --ci              the sessions of `make test-ui` and no others
    --minutes N       begin no further session after N minutes, and name those left out
    --extension ZIP   another version of the extension than the one at hand
"""

from __future__ import annotations

import argparse
import fcntl
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
SAMPLE = REPOSITORY / "sample" / "scene"
LIMIT_S = 1200
FIRST_DISPLAY = {"trixie": 93, "sid": 113}
"""By release: displays are the machine's, whatever Debian opens them."""
SLOTS = 8
"""How many runs there may be at once, each with a display and a work folder of its own."""
WINDOW = os.environ.get("UNISIM_UI_WINDOW", "1600x900").split("x")
BLENDER = ["blender", "--factory-startup", "--no-window-focus", "-p", "0", "0", *WINDOW]
SESSIONS = {
    "person": ["--enable-event-simulate"],
    "edits": ["--enable-event-simulate"],
    "variants": ["--enable-event-simulate"],
    "displaced": ["--enable-event-simulate"],
    "retimed": ["--enable-event-simulate"],
    "placing": ["--enable-event-simulate"],
    "maneuvers": ["--enable-event-simulate"],
    "sequences": ["--enable-event-simulate"],
    "simulate": ["--enable-event-simulate"],
    "rollouts": ["--enable-event-simulate"],
    "batches": ["--enable-event-simulate"],
    "panel": ["--enable-event-simulate"],
    "overview": ["--enable-event-simulate"],
    "points": ["--enable-event-simulate"],
    "first_drive": ["--enable-event-simulate"],
    "window": [],
    "hands": ["--enable-event-simulate"],
    "motion": ["--enable-event-simulate"],
    "scale": ["--enable-event-simulate"],
    "actors": ["--enable-event-simulate"],
    "finish": ["--enable-event-simulate"],
    "rigs": ["--enable-event-simulate"],
    "compare": ["--enable-event-simulate"],
    "layouts": ["--enable-event-simulate"],
    "errors": ["--enable-event-simulate"],
    "ten_tasks": ["--enable-event-simulate"],
    "importing": ["--enable-event-simulate"],
    "first_image": ["--enable-event-simulate"],
    "tracks": ["--enable-event-simulate"],
    "lamps": ["--enable-event-simulate"],
}
"""What each file's Blender is started with besides; the one with simulated events hears no others."""
CI_SESSIONS = ("person", "displaced", "panel", "points", "window", "hands")
"""What `make test-ui` runs; `make test-ui-all` runs all."""
ESC_S = 3.0
"""How long a render job may go on after Esc, in seconds: half a second where nothing else runs."""
LOG_PACKAGES = (
    "pyarrow", "nvidia-ncore==19.8.3", "dataclasses-json", "marshmallow<4", "typing-inspect", "typing-extensions",
    "mypy-extensions", "zarr==2.18.7", "asciitree", "numcodecs==0.15.1", "fasteners", "deprecated", "wrapt", "cbor2",
    "universal-pathlib", "fsspec", "pathlib-abc", "packaging", "scipy",
)  # fmt: skip
"""What the layouts Argoverse 2, Waymo and NCore need beside the extension's own packages, without torch, which NCore names."""
WITHIN_BYTES = 1.0
"""How far the viewport and F12 may be apart, in steps of eight bits."""


def main(
    root: Path,
    release: str,
    out: Path,
    only: Sequence[str] = (),
    extension: Path | None = None,
    minutes: float = math.inf,
) -> int:
    """Set up, run all sessions or those named ``only``, and say what is wrong; return the exit code. No session begins
    once ``minutes`` have passed."""
    begun_s = time.monotonic()
    if unknown := set(only) - set(SESSIONS):
        raise SystemExit(f"Error: {', '.join(unknown)}: no session has this name; there are {', '.join(SESSIONS)}")
    chosen = {name: flags for name, flags in SESSIONS.items() if not only or name in only}
    with (root.parent / f"{root.name}.setup").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another run may be making the same Debian
        subprocess.run(["sh", str(HERE / "chroot.sh"), str(root), release], check=True)
    archive = extension or built_extension()
    slot, _held = free_slot(root, FIRST_DISPLAY[release])
    display, inner = f":{FIRST_DISPLAY[release] + slot}", f"/tmp/unisim-{slot}"
    work = root / inner[1:]
    shutil.rmtree(work, ignore_errors=True)
    (work / "shots").mkdir(parents=True)
    shutil.copy(archive, work / "unisim.zip")
    for script in HERE.glob("*.py"):
        shutil.copy(script, work)
    own_scene, own = os.environ.get("UNISIM_UI_SCENE"), os.environ.get("UNISIM_UI_LOG")
    place_scene(root, Path(own_scene) if own_scene else SAMPLE, Path(inner, "scene"))
    if "ten_tasks" in chosen:
        place_scene(root, SAMPLE, Path(inner, "another"))
    if "sequences" in chosen:
        shutil.copytree(synthetic("small", "3", "96", "54"), work / "small")
    needed = {"importing", "maneuvers"} if own_scene else {"importing", "maneuvers", "ten_tasks"}
    if own or needed & set(chosen):
        recorded = own or (street() if "importing" in chosen else synthetic("long", "80", "96", "54"))
        shutil.copytree(recorded, work / "log")
    if "lamps" in chosen:
        shutil.copytree(synthetic("lamps", "20", "480", "270", "--lamps"), work / "lamp_log")
    if "tracks" in chosen and not own:
        without_boxes(street(), work)
    if {"layouts", "tracks"} & set(chosen):
        shutil.copytree(log_packages(root), work / "packages")
    if "layouts" in chosen:
        shutil.copytree(street_layouts(), work / "layouts")
    (root / "tmp" / ".X11-unix").mkdir(mode=0o1777, exist_ok=True)
    screen = subprocess.Popen([*inside(root), "Xvfb", display, "-screen", "0", "1600x900x24", "-nolisten", "tcp"])
    try:
        time.sleep(3)
        if screen.poll() is not None:
            raise SystemExit(f"Error: no screen could be opened at {display}: is another one running?")
        arguments = ["--", f"{inner}/unisim.zip", f"{inner}/scene/scene.json", f"{inner}/shots"]
        with (work / "log.txt").open("w") as log:
            for name, flags in list(chosen.items()):
                if time.monotonic() - begun_s > 60 * minutes:
                    del chosen[name]
                    print(f"{name}.py was left out: {minutes:g} minutes have passed")
                    continue
                blender = [*BLENDER, *flags, "--python", f"{inner}/{name}.py", *arguments]
                started = [*at_home(root, display, f"{inner}/{name}_home"), *blender]
                with suppress(subprocess.TimeoutExpired):  # what it left is judged
                    subprocess.run(started, timeout=LIMIT_S, stdout=log, stderr=log, check=False)
        command = ["blender", "-b", f"{inner}/drive.blend", "--command", "unisim", "render", "--out", f"{inner}/frames"]
        wanted = ["--frames", "4:6", "--width", "96", "--sensors", "front_camera,pandar64", "--jobs", "2"]
        headless = [*at_home(root, display, f"{inner}/window_home"), *command, *wanted]
        ended = None
        if "window" in chosen:  # which leaves the file
            ended = subprocess.run(
                headless, timeout=LIMIT_S, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
            )
    finally:
        screen.terminate()
        screen.wait()
    for name in chosen:  # what an earlier run left here is no result of this one
        (out / f"{name}.json").unlink(missing_ok=True)
    shutil.copytree(work / "shots", out, dirs_exist_ok=True)
    shutil.copy(work / "log.txt", out)
    left = [
        len(list((work / "frames").glob(f"{kind}/*/*{suffix}")))
        for kind, suffix in (("camera", ".png"), ("lidar", ".ply"))
    ]
    # Debian's Blender 5.2 has a traceback of its own: it lacks a package
    if ended is not None and (
        ended.returncode or left != [2, 2] or re.search(r"Traceback[^\n]*\n(  .*\n)*.*unisim", ended.stdout)
    ):
        print(ended.stdout)
        print(
            f"Error: blender --command unisim render ended with {ended.returncode} and left {left} images and sweeps of 2"
        )
        return 1
    return judge(out, list(chosen))


def built_extension() -> Path:
    """Return the extension's archive, built from what is at hand."""
    build = [sys.executable, str(REPOSITORY / "tools" / "build_extension.py")]
    return Path(subprocess.run(build, check=True, capture_output=True, text=True).stdout.split("\n")[-2])


def place_scene(root: Path, scene: Path, target: Path) -> None:
    """Copy a trained scene to ``target`` in that Debian, and its log to where the scene names it."""
    named = json.loads((scene / "scene.json").read_text())["log"]["path"]
    log = street() if scene == SAMPLE else (scene / named).resolve()
    shutil.copytree(scene, root / str(target).lstrip("/"))
    shutil.copytree(log, root / os.path.normpath(target / named).lstrip("/"), dirs_exist_ok=True)


def street() -> Path:
    """Return the folder of the log that the sample's scene is trained on, made where it is missing."""
    return synthetic("street", "20", "480", "270")


def synthetic(name: str, frames: str, width: str, height: str, *more: str) -> Path:
    """Return the folder of a log of a procedural street, made where it is missing."""
    folder = REPOSITORY / "out" / name
    if not folder.is_dir():
        recipe = ["--frames", frames, "--width", width, "--height", height, "--seed", "0", *more]
        subprocess.run([str(Path(sys.executable).parent / "unisim"), "synth", str(folder), *recipe], check=True)
    return folder


def without_boxes(log: Path, work: Path, frame: int = 9) -> None:
    """Copy a street's log without its boxes to ``work``/log, and beside it where its cars are at a frame, nearest first."""
    sys.path.insert(0, str(REPOSITORY))
    import numpy as np

    from unisim_blender.core.formats.readers import open_log

    drive = open_log(log).drive
    time_s = drive.time_s[frame]
    ego = drive.world_from_ego.at(time_s)[:2, 3]
    rows = []
    for uid, actor in drive.actors.items():
        if actor.label == "Car" and actor.present(time_s):
            pose = actor.world_from_actor.at(time_s)
            yaw = math.atan2(pose[1, 0], pose[0, 0])
            rows.append([uid, actor.is_moving, pose[:3, 3].tolist(), yaw, np.asarray(actor.size_m).tolist()])
    rows.sort(key=lambda row: math.dist(row[2][:2], ego))
    shutil.copytree(log, work / "log", dirs_exist_ok=True)
    shutil.rmtree(work / "log" / "annotations" / "cuboids")
    (work / "truth_boxes.json").write_text(json.dumps(rows))


def street_layouts() -> Path:
    """Return the folder of a procedural street in every layout of logs, made where it is missing."""
    folder = REPOSITORY / "out" / "layouts"
    if not (folder / "truth.json").is_file():
        shutil.rmtree(folder, ignore_errors=True)
        writer = REPOSITORY / "tests" / "support" / "street_layouts.py"
        subprocess.run([sys.executable, str(writer), str(folder)], check=True)
    return folder


def log_packages(root: Path) -> Path:
    """Return a folder of `LOG_PACKAGES` for that Debian's Python; it lacks those that have none for it."""
    ask = "import sys; print('%d%d' % sys.version_info[:2])"
    python = subprocess.run(
        [*inside(root), "python3", "-c", ask], capture_output=True, text=True, check=True
    ).stdout.strip()
    folder = REPOSITORY / "out" / "ui_packages" / f"cp{python}"
    if folder.is_dir():
        return folder
    folder.mkdir(parents=True)
    served = [f"manylinux_2_{number}_x86_64" for number in (28, 27)] + ["manylinux2014_x86_64", "any"]
    platforms = [argument for name in served for argument in ("--platform", name)]
    kinds = [argument for name in (f"cp{python}", "abi3", "none") for argument in ("--abi", name)]
    # built here, a package would be this Python's; one of them is of pure Python and has no wheel
    ready = ["--only-binary", ":all:", "--no-binary", "asciitree"]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder)]
    pip += [*ready, *platforms, *kinds]
    for package in LOG_PACKAGES:
        subprocess.run([*pip, "--python-version", python, "--implementation", "cp", package], check=False)
    return folder


def free_slot(root: Path, first: int) -> tuple[int, TextIO]:
    """Return the number of a slot that no other run uses, and its lock, held until this process ends; its display,
    counted from ``first``, is free."""
    open_displays = Path("/proc/net/unix").read_text()
    for slot in range(SLOTS):
        if f"/tmp/.X11-unix/X{first + slot}\n" in open_displays:
            continue
        lock = (root / f".lock-{slot}").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        return slot, lock
    raise SystemExit(f"Error: {root}: {SLOTS} other runs of the window's tests are at work there")


def inside(root: Path) -> list[str]:
    """Return how a command is started inside that Debian, with mounts that end with it."""
    enter = 'for part in proc dev; do mount --rbind /$part "$0/$part" || exit; done; exec chroot "$0" "$@"'
    return ["unshare", "--mount", "sh", "-c", enter, str(root)]


def at_home(root: Path, display: str, home: str) -> list[str]:
    """Return how a command of that Debian's is started, with settings that are a session's own."""
    (root / home[1:]).mkdir(exist_ok=True)
    software = ["LIBGL_ALWAYS_SOFTWARE=1", "LC_ALL=C.UTF-8"]
    return [*inside(root), "env", f"DISPLAY={display}", f"HOME={home}", *software]


def judge(out: Path, sessions: list[str]) -> int:
    """Print the results of some sessions; return 1 where something is wrong."""
    results: dict[str, dict[str, Any]] = {}
    without = []
    for name in sessions:
        path = out / f"{name}.json"
        if path.is_file():
            results[name] = json.loads(path.read_text())
        else:
            without.append(name)
    print(json.dumps(results, indent=1))
    rows = [(name, took) for result in results.values() for name, took in result.get("tasks", {}).items()]
    (out / "tasks.json").write_text(json.dumps(dict(rows), indent=1))
    titles = f"{'task':24}{'steps':>6}{'presses':>8}{'seconds':>9}{'no waiting':>11}{'longest block, s':>18}"
    print(f"{titles}{'redraw alone, s':>17}{'ours, s':>9}")
    for name, took in rows:
        ended = f"   failed: {took['failed']}" if "failed" in took else ""
        print(
            f"{name:24}{took['steps']:6}{took['presses']:8}{took['seconds']:9.2f}{took['without_waiting_s']:11.2f}"
            f"{took['longest_block_s']:18.3f}{took['redraw_s']:17.3f}{took['ours_s']:9.2f}{ended}"
        )
    window = results.get("window", {})
    wrong = [f"{name}.py left no results, see {out / 'log.txt'}" for name in without]
    wrong += [
        message
        for holds, message in (
            *((result.get("done", False), f"{name}.py broke off") for name, result in results.items()),
            *(("failed" not in took, f"{name}: {took.get('failed')}") for name, took in rows),
            *((len(users) == 1, f"{name}: is a task of {' and of '.join(users)}") for name, users in users_of(results)),
            *(judged(window) if "window" in sessions else ()),
        )
        if not holds
    ]
    for message in wrong:
        print(f"Error: {message}")
    return 1 if wrong else 0


def users_of(results: dict[str, dict[str, Any]]) -> list[tuple[str, list[str]]]:
    """Return the name of every task, and the sessions that have a task of that name."""
    users: dict[str, list[str]] = {}
    for session, result in results.items():
        for name in result.get("tasks", {}):
            users.setdefault(name, []).append(session)
    return list(users.items())


def judged(window: dict[str, Any]) -> list[tuple[bool, str]]:
    """Return what has to hold of the session window.py, and what is said where it does not."""
    return [
        (window.get("own_python", False), "it was not Blender's own Python that rendered"),
        ("torch" in window.get("packages_lacking", []), "torch is installed there: nothing is shown by an image"),
        (window.get("sweep_points", 0) > 1000, "the simulated sweep is empty"),
        (window.get("viewport_and_f12", 99.0) <= WITHIN_BYTES, "viewport and F12 differ"),
        (window.get("refresh_changed", 0.0) > 0.05, "moving a box changed nothing"),
        (window.get("mesh_changed", 0.0) > 0.05, "a mesh made an actor is not to be seen"),
        (window.get("esc_s", 99.0) <= ESC_S, "Esc does not stop F12 at once"),
        ("killed" in str(window.get("after_kill", "")), "nobody said that the worker was killed"),
    ]


def arguments() -> argparse.Namespace:
    """Return what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("release", choices=("trixie", "sid"))
    parser.add_argument("out", type=Path)
    parser.add_argument("sessions", nargs="*", metavar="session")
    parser.add_argument("--ci", action="store_true")
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--extension", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    said = arguments()
    wanted_sessions = said.sessions or (CI_SESSIONS if said.ci else ())
    sys.exit(main(said.root, said.release, said.out, wanted_sessions, said.extension, said.minutes))
