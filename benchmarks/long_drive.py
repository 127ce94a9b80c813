"""What a long drive costs to open and to start training on: seconds and memory of `unisim info` and of the first steps.

python benchmarks/long_drive.py FOLDER [--frames 1000] [--base LOG] [--width 1920] [--height 1080] [--preset NAME]
[--ncore]

FOLDER/log is made where it is not there: a street of a few frames, again and again along a straight road, each time further on
and later, with actors of its own; its images, enlarged, are links to a few files. FOLDER/ncore is that log as NCore, which
`--ncore` measures in its place. What is measured runs in a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from PIL import Image

from unisim_blender.core.formats.pandaset import write as pandaset_write
from unisim_blender.core.formats.pandaset.sensors import CAMERAS, PANDAR64
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.world.drive import Drive
from unisim_street.layout import FRAME_S, SPEED_M_S
from unisim_street.street import build_street
from unisim_street.write import write_log

SWEEPS = 10
"""Sweeps of which an NCore log's are made, each again and again."""
USED = """
import json, resource, sys, time
begun = time.perf_counter()
from pathlib import Path

def now():
    used, held = resource.getrusage(resource.RUSAGE_SELF), Path("/proc/self/status").read_text().split()
    held_mb, peak_mb = (int(held[held.index(name) + 1]) / 1e3 for name in ("VmRSS:", "VmHWM:"))
    read_mb = int(Path("/proc/self/io").read_text().split()[1]) / 1e6
    cpu_s = used.ru_utime + used.ru_stime
    return {"s": time.perf_counter() - begun, "cpu_s": cpu_s, "held_mb": held_mb, "peak_mb": peak_mb, "read_mb": read_mb}
"""
INFO = (
    USED
    + """
from unisim_blender.core.cli.main import run
run(sys.argv[1:])
print(json.dumps({"info": now()}), file=sys.stderr)
"""
)
TRAIN = (
    USED
    + """
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.loop import keep_freed_memory
from unisim_blender.core.training.trainer import Trainer

path, preset, width, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]) or None, int(sys.argv[4])
found = {"imported": now()}
keep_freed_memory()
log = open_log(path)
found["opened"] = now()
drive = log.drive
lidars = tuple(name for name in drive.lidars if drive.lidars[name].model.beams)
trainer = Trainer(log, TrainConfig(tuple(drive.cameras), lidars, drive.frames[::2], width, preset, iterations=10 * steps))
found["made"] = now()
for step in range(steps + 1):
    if step in (1, steps // 2, steps):
        found[f"{step} steps"] = now()
    trainer.step()
print(json.dumps(found), file=sys.stderr)
"""
)


def make_long(base: Path, out: Path, frames: int, width: int, height: int) -> None:
    """Write a log of so many frames and images of a size from a short one of the same street; see above."""
    short = open_log(base)
    drive, count = short.drive, len(short.drive.frames)
    duration_s, length = count * FRAME_S, np.array([count * FRAME_S * SPEED_M_S, 0.0, 0.0])
    rounds = -(-frames // count)
    numbers = tuple(range(frames))

    def longer(trajectory: Trajectory) -> Trajectory:
        n = len(trajectory.times_s)
        turn = np.repeat(np.arange(rounds), n)[:frames]
        of = np.tile(np.arange(n), rounds)[:frames]
        times = trajectory.times_s[of] + duration_s * turn
        return Trajectory(times, trajectory.positions[of] + length * turn[:, None], trajectory.quaternions_wxyz[of])

    def stamps(time_s: dict[int, float]) -> dict[int, float]:
        return {frame: time_s[frame % count] + duration_s * (frame // count) for frame in numbers}

    cameras, images = {}, {}
    for name, camera in drive.cameras.items():
        model = replace(camera.model.resized(width), height=height)
        cameras[name] = replace(
            camera, model=model, world_from_camera=longer(camera.world_from_camera), time_s=stamps(camera.time_s)
        )
        images[name] = [Image.fromarray(short.image(name, frame)).resize((width, height)) for frame in drive.frames]
    lidar = drive.lidars[PANDAR64]
    lidars = {PANDAR64: replace(lidar, world_from_lidar=longer(lidar.world_from_lidar), time_s=stamps(lidar.time_s))}
    actors = {}
    for uid, actor in drive.actors.items():
        if len(actor.world_from_actor.times_s) == count and _keeps_step(actor.world_from_actor, length):
            end_s = frames * FRAME_S + actor.end_s
            actors[uid] = replace(actor, world_from_actor=longer(actor.world_from_actor), end_s=end_s)
    stay = tuple(actors)
    for turn in range(rounds):
        for uid, actor in drive.actors.items():
            if uid in stay:
                continue
            track, shift = actor.world_from_actor, duration_s * turn
            moved = Trajectory(track.times_s + shift, track.positions + length * turn, track.quaternions_wxyz)
            actors[f"{uid}-{turn}"] = replace(
                actor, uid=f"{uid}-{turn}", world_from_actor=moved, start_s=actor.start_s + shift,
                end_s=min(actor.end_s, (count - 0.5) * FRAME_S) + shift,
                appearance=replace(actor.appearance, actor=f"{uid}-{turn}"),
            )  # fmt: skip
    long = Drive(
        "long", numbers, stamps(drive.time_s), longer(drive.world_from_ego), cameras, lidars, actors,
        world_origin=drive.world_origin,
    )  # fmt: skip
    writer = PandasetWriter(out, long)
    pandaset_write.COMPRESSION = 1  # a thousand sweeps in minutes
    sweeps = [short.sweep(PANDAR64, frame) for frame in drive.frames]
    of_turn = [{uid: actors[uid] for uid in stay} for _ in range(rounds)]
    for uid, actor in actors.items():
        if uid not in stay:
            of_turn[int(uid.rsplit("-", 1)[1])][uid] = actor
    for frame in numbers:
        turn, of = divmod(frame, count)
        sweep, along = sweeps[of], length * turn
        writer.write_sweep(
            frame,
            {PANDAR64: replace(sweep, points=_coarse(sweep.points + along), time_s=sweep.time_s + duration_s * turn)},
        )
        writer.drive = replace(long, actors=of_turn[turn])
        writer.write_cuboids(frame)
        for name in cameras:
            if turn == 0:
                writer.write_image(name, frame, np.asarray(images[name][of]))
            else:
                os.link(writer.image_path(name, of), writer.image_path(name, frame))
        if frame % 100 == 0:
            click.echo(f"{frame} of {frames} frames", err=True)
    writer.drive = long
    writer.finish()


def _keeps_step(trajectory: Trajectory, length: FloatArray) -> bool:
    """Whether an actor drives about as far as the ego vehicle does, and so goes on from one round to the next."""
    way = trajectory.positions[-1] - trajectory.positions[0]
    return bool(np.linalg.norm(way - length * (1 - 1 / len(trajectory.times_s))) < 3.0)


def _coarse(points: FloatArray) -> FloatArray:
    """Points to a millimetre, which pack as recorded ones do."""
    return np.round(points, 3)


def make_ncore(long: Path, out: Path) -> None:
    """Write the log ``long`` of `make_long` as an NCore sequence in a folder; its sweeps' returns, without drops."""
    from unisim_blender.core.formats.ncore.write import NcoreWriter

    log = open_log(long)
    drive = log.drive
    step_m = np.array([FRAME_S * SPEED_M_S, 0.0, 0.0])
    sweeps = [log.sweep(PANDAR64, frame) for frame in drive.frames[:SWEEPS]]
    with NcoreWriter(out, drive) as writer:
        for frame in drive.frames:
            for name in drive.cameras:
                path = log.image_path(name, frame)
                assert path is not None
                writer.write_image(name, frame, path.read_bytes())
            turn, of = divmod(frame, len(sweeps))
            sweep, later_s = sweeps[of], drive.time_s[frame] - drive.time_s[of]
            points = sweep.points + step_m * turn * len(sweeps)
            writer.write_sweep(PANDAR64, frame, replace(sweep, points=points, time_s=sweep.time_s + later_s))
            if frame % 100 == 0:
                click.echo(f"{frame} of {len(drive.frames)} frames", err=True)


def measured(program: str, *arguments: str) -> tuple[str, dict[str, dict[str, float]]]:
    """Return what a program printed, and the seconds, those of processors, and memory in MB that it counted itself.

    A parent would count its own memory, too, which a process has as its largest before it begins.
    """
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise click.ClickException(done.stderr)
    return done.stdout, json.loads(done.stderr.splitlines()[-1])


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--frames", default=1000, show_default=True)
@click.option("--base", type=click.Path(exists=True, path_type=Path), help="A street's log to make it of.")
@click.option("--width", default=1920, show_default=True, help="Of the log's images.")
@click.option("--height", default=1080, show_default=True)
@click.option("--train-width", default=0, show_default=True, help="Of those that are trained on; 0: as recorded.")
@click.option("--preset", default="small", show_default=True)
@click.option("--ncore", is_flag=True, help="Measure on the log as NCore.")
@click.option("--steps", default=20, show_default=True, help="Steps of training; 0: none.")
def main(
    folder: Path,
    frames: int,
    base: Path | None,
    width: int,
    height: int,
    train_width: int,
    preset: str,
    ncore: bool,
    steps: int,
) -> None:
    """Make a long log in FOLDER and measure on it."""
    if base is None:
        base = folder / "base"
        if not (base / "meta" / "unisim.json").exists():
            write_log(build_street(0, 10, 480, 270, CAMERAS), base, 2)
    log = folder / "log"
    if not (log / "meta" / "unisim.json").exists():
        make_long(base, log, frames, width, height)
    if ncore:
        sequence = folder / "ncore"
        if not sequence.exists():
            make_ncore(log, sequence)
        log = sequence
    printed, used = measured(INFO, "info", str(log), "--json")
    about = json.loads(printed)
    total = sum(count["moving"] + count["still"] for count in about["actors"].values())
    click.echo(
        f"{len(about['frames'])} frames, {len(about['cameras'])} cameras, {total} actors; load {os.getloadavg()[0]:.1f}"
    )
    if steps:
        used |= measured(TRAIN, str(log), preset, str(train_width), str(steps))[1]
    for what, of in used.items():
        click.echo(f"{what:>12}: " + ", ".join(f"{name} {value:.1f}" for name, value in of.items()))


if __name__ == "__main__":
    main()
