"""Two commits beside each other in one run: seconds per image and sweep, errors, memory.

    git worktree add ../base COMMIT      # with its kernels built
    python -m benchmarks.beside_commit ../base --scene sample/scene --frame 10 --quality fine

Each commit renders in a process of its own; they take turns, and ratios are medians over the rounds. Errors are against
16 times the samples: of images in windows, of sweeps in every 16th column.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

SERVE = """
import pickle, sys
from pathlib import Path
# an editable install's finder would give every process the installed tree
sys.meta_path = [x for x in sys.meta_path if "Redirecting" not in type(x).__name__]
import unisim_blender
assert Path(unisim_blender.__file__).is_relative_to(Path.cwd()), unisim_blender.__file__
from unisim_bench.render_request import RenderRequest, RenderSession, SceneSetup
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.quality import QUALITIES, TRUTH_QUALITY
session, out, sys.stdout = RenderSession(), sys.stdout.buffer, sys.stderr
while True:
    try:
        scene, sensor, frame, threads, quality, width, windows, step = pickle.load(sys.stdin.buffer)
    except EOFError:
        break
    chosen, whole = (TRUTH_QUALITY, False) if quality is None else (QUALITIES[quality], True)
    setup = SceneSetup(Path(scene), sensor, frame, threads=threads)
    request = RenderRequest(setup, sensor, chosen, width, tuple(Region(*x) for x in windows), step, whole)
    measured = session.render(request)
    out.write(pickle.dumps((measured.seconds, measured.samples, measured.peak_bytes, measured.pieces)))
    out.flush()
"""
"""What the process of a commit runs: it answers pickled requests."""
WINDOWS, WINDOW, COLUMN_STEP = (3, 2), (96, 64), 16


class CommitProcess:
    """A process that renders with the code and the kernels of a working tree."""

    def __init__(self, tree: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(tree)}
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVE], cwd=tree, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def render(self, *request: Any) -> tuple[float, int, int, list[NDArray[np.float32]]]:
        """Return seconds, samples, the most bytes held, and what `RenderSession` keeps of an image or a sweep."""
        assert self._process.stdin and self._process.stdout
        pickle.dump(request, self._process.stdin)
        self._process.stdin.flush()
        measured: tuple[float, int, int, list[NDArray[np.float32]]] = pickle.load(self._process.stdout)
        return measured

    def close(self) -> None:
        """Let it end."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def error_of(pieces: list[NDArray[np.float32]], truth: list[NDArray[np.float32]], image: bool) -> str:
    """Return an image's PSNR, or quantiles of a sweep's depth error."""
    if image:
        squared = np.mean([np.square(a - b) for a, b in zip(pieces, truth, strict=True)])
        return f"{-10 * np.log10(squared):.2f} dB"
    both = (pieces[0] > 0) & (truth[0] > 0)
    off = np.abs(pieces[0] - truth[0])[both]
    return f"median {1e3 * np.median(off):.3f} mm, 90th percentile {1e3 * np.quantile(off, 0.9):.2f} mm"


@click.command()
@click.argument("other", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--scene", type=click.Path(exists=True, path_type=Path), default=Path("sample/scene"), show_default=True)
@click.option("--frame", default=10, show_default=True)
@click.option("--camera", default="front_camera", show_default=True)
@click.option("--lidar", default="pandar64", show_default=True)
@click.option("--width", default=1920, show_default=True)
@click.option("--height", default=1080, show_default=True, help="That the camera has at this width.")
@click.option("--quality", default="fine", show_default=True, help="Of images.")
@click.option("--sweep-quality", default="balanced", show_default=True)
@click.option("--rounds", default=5, show_default=True)
@click.option("--threads", default=os.cpu_count() or 1, show_default=True)
def main(
    other: Path,
    scene: Path,
    frame: int,
    camera: str,
    lidar: str,
    width: int,
    height: int,
    quality: str,
    sweep_quality: str,
    rounds: int,
    threads: int,
) -> None:
    """Print what images and sweeps take with the working tree OTHER and with this one."""
    trees = {"other": other.absolute(), "this": Path(__file__).parents[1]}
    processes = {name: CommitProcess(tree) for name, tree in trees.items()}
    places = [((i + 0.5) / WINDOWS[0], (j + 0.5) / WINDOWS[1]) for j in range(WINDOWS[1]) for i in range(WINDOWS[0])]
    corners = [(int(x * width - WINDOW[0] / 2), int(y * height - WINDOW[1] / 2)) for x, y in places]
    windows = tuple((x, y, x + WINDOW[0], y + WINDOW[1]) for x, y in corners)
    for sensor, of_quality, size in ((camera, quality, width), (lidar, sweep_quality, 0)):
        asked = str(scene.absolute()), sensor, frame, threads
        kept = (size, windows if size else (), 1 if size else COLUMN_STEP)
        truth = processes["this"].render(*asked, None, *kept)[3]
        seconds: dict[str, list[float]] = {name: [] for name in processes}
        for _ in range(rounds):
            for name, process in processes.items():
                measured = process.render(*asked, of_quality, *kept)
                seconds[name].append(measured[0])
                if len(seconds[name]) == rounds:
                    click.echo(
                        f"{sensor} {of_quality}, {name}: {np.median(seconds[name]):.3f} s, {measured[1] / 1e6:.1f} M "
                        f"samples, {error_of(measured[3], truth, size > 0)}, {measured[2] >> 20} MiB"
                    )
        ratio = np.median(np.array(seconds["other"]) / np.array(seconds["this"]))
        click.echo(f"{sensor}: {ratio:.2f} times as fast")
    for process in processes.values():
        process.close()


if __name__ == "__main__":
    main()
