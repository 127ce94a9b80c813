"""One command for a GPU: kernels against torch, trainings at full size, times and a profile, as one JSON.

python benchmarks/gpu.py --out FOLDER [--device cuda] [--budget 600] [--seconds 60] [--size 1920 1080] [--frames 6]

It needs no network and no data: it builds the native library where that is missing and makes a street of its own. A stage
that fails leaves its traceback in the JSON, which is written anew after each, and the next begins; none begins once the
budget is spent. Without a GPU, this tries it in minutes, with Triton's interpreter for the kernels:

TRITON_INTERPRET=1 python benchmarks/gpu.py --out FOLDER --device cpu --seconds 5 --size 96 54 --frames 4 --samples 500 \\
    --qualities fast --rounds 1
"""

from __future__ import annotations

import ast
import json
import os
import platform
import statistics
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
KERNEL_BOUND = 2e-5
"""Largest error of a kernel, as a share of the largest value that torch's float64 has."""
PRESETS = ("small", "paper")
ROUNDS = 5


class Report:
    """The JSON of a run: written anew, as a whole, after each stage."""

    def __init__(self, file: Path, budget_s: float) -> None:
        self.file, self.until = file, time.monotonic() + budget_s
        self.values: dict[str, Any] = {"failed": []}

    def left_s(self) -> float:
        """Return how many seconds of the budget are left."""
        return self.until - time.monotonic()

    def stage(self, name: str, work: Callable[[], Any]) -> Any:
        """Run a stage and note what it returns, or its traceback; return None where it failed."""
        begun, result = time.monotonic(), None
        try:
            if self.left_s() <= 0:
                raise TimeoutError("the budget is spent")
            result = work()
            self.values[name] = result
        except Exception:  # noqa: BLE001 the next stage is worth its time all the same
            self.values[name] = {"error": traceback.format_exc()}
            self.values["failed"].append(name)
        self.values.setdefault("stage_s", {})[name] = round(time.monotonic() - begun, 2)
        temporary = self.file.with_suffix(".part")
        temporary.write_text(json.dumps(self.values, indent=1, default=str))
        os.replace(temporary, self.file)
        said = "failed" if name in self.values["failed"] else json.dumps(result, default=str)[:160]
        click.echo(f"{name}: {self.values['stage_s'][name]} s, {said}")
        return result


def machine(device: str) -> dict[str, Any]:
    """Return what it is measured on."""
    import numpy
    import torch

    nvcc = subprocess.run(["sh", "-c", "nvcc --version | tail -1"], capture_output=True, text=True, check=False).stdout.strip()
    commit = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    found: dict[str, Any] = {"python": platform.python_version(), "torch": torch.__version__, "numpy": numpy.__version__}
    try:
        import triton

        found["triton"] = triton.__version__
    except ImportError:
        found["triton"] = None
    if device == "cuda":
        found |= {"device": torch.cuda.get_device_name(), "memory_bytes": torch.cuda.get_device_properties(0).total_memory}
    return {**found, "nvcc": nvcc, "commit": commit, "cores": os.cpu_count()}


def build_native(out: Path) -> dict[str, Any]:
    """Build the native library beside its loader where there is none that loads; return which variant it runs."""
    from unisim_blender.core import native

    if native.library() is None:
        folder = out / "build"
        options = ["-DSKBUILD_STATE=editable", "-DSKBUILD_PROJECT_NAME=unisim_blender", "-DCMAKE_BUILD_TYPE=Release"]
        for command in (["cmake", "-S", str(ROOT), "-B", str(folder), *options], ["cmake", "--build", str(folder), "-j"]):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{' '.join(command)}: {(done.stdout + done.stderr)[-3000:]}")
        code = "from unisim_blender.core import native; print(native.variant())"
        told = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        return {"built": True, "variant": told.stdout.strip()}
    return {"built": False, "variant": native.variant()}


def error_of(got: Any, want: Any) -> float:
    """Return the largest difference of two tensors as a share of the largest value of the second, which is float64."""
    scale = float(want.abs().max().clamp_min(1e-3))
    return float((got.double() - want).abs().max()) / scale


def kernel_names() -> set[str]:
    """Return the names of all of Triton's kernels that are launched: `triton.jit` functions that none of them calls."""
    jitted: dict[str, ast.FunctionDef] = {}
    called: set[str] = set()
    for file in sorted((ROOT / "unisim_blender" / "core" / "on_gpu").glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef) and any("jit" in ast.unparse(d) for d in node.decorator_list):
                jitted[f"{file.stem}.{node.name}"] = node
    for name, node in jitted.items():
        called |= {
            f"{name.split('.')[0]}.{c.func.id}"
            for c in ast.walk(node)
            if isinstance(c, ast.Call) and isinstance(c.func, ast.Name)
        }
    return set(jitted) - called


def compare_kernels(device: str, scale: int) -> dict[str, Any]:
    """Return each kernel's largest errors beside torch in float64, values and gradients, and which kernels were not launched."""
    import torch
    import triton

    from unisim_blender.core import kernel_choice
    from unisim_blender.core.composite import gather, gather_reference
    from unisim_blender.core.fields.fields import query
    from unisim_blender.core.fields.grid_shape import GridArrays, GridShape
    from unisim_blender.core.fields.hash_grid import encode, encode_reference
    from unisim_blender.core.fields.networks import mlp, run_mlp
    from unisim_blender.core.march import Segment, Voxels, propose, propose_reference
    from unisim_blender.core.strands import Strands

    before = vars(kernel_choice)["ready"]
    if device == "cpu":
        vars(kernel_choice)["ready"] = lambda like: True  # Triton's interpreter takes the CPU's tensors
    launched: set[str] = set()
    original = triton.runtime.jit.KernelInterface.__getitem__

    def noted(self: Any, grid: Any) -> Any:
        function = getattr(self, "fn", self)
        launched.add(f"{function.__module__.split('.')[-1]}.{function.__name__}")
        return original(self, grid)

    triton.runtime.jit.KernelInterface.__getitem__ = noted
    found: dict[str, Any] = {}
    generator = torch.Generator().manual_seed(1)
    try:
        shape = GridShape.cubic((240.0, 120.0, 40.0), 3.2, 0.05, 8, 4, 17) if scale > 1000 else GridShape.unit(4, 12, 3, 2, 12)
        for grids in (1, 3):
            grid, n = GridArrays(shape), scale
            table = torch.randn(grids, grid.rows, shape.features, generator=generator)
            index = None if grids == 1 else torch.randint(grids, (n,), generator=generator).to(device)
            x = torch.rand(n, 3, generator=generator)
            near = (x.double()[:, None] * torch.tensor(grid.scale, dtype=torch.float64)).frac()
            sure = ((near > 1e-3) & (near < 1 - 1e-3)).flatten(1).all(1)  # slopes jump at cells' edges
            given = torch.randn(n, shape.width, generator=generator)
            outs = []
            for kind, dtype in ((encode, torch.float32), (encode_reference, torch.float64)):
                t = (table if grids > 1 else table[0]).to(device, dtype, copy=True).requires_grad_()
                p = x.to(device, dtype, copy=True).requires_grad_()
                out = kind(grid, t, p, index)
                out.backward(given.to(device, dtype))
                assert t.grad is not None and p.grad is not None
                outs.append((out.detach(), t.grad, p.grad[sure.to(device)]))
            names = ("value", "table gradient", "point gradient")
            found[f"encode, {grids} grids"] = {k: error_of(a, b) for k, a, b in zip(names, *outs, strict=True)}
            network = mlp(shape.width, 64, 32).to(device)
            with torch.no_grad():
                t, p = (table if grids > 1 else table[0]).to(device), x.to(device)
                got = query(grid, t, network, p, index)
                code = encode_reference(grid, t.double(), p.double(), index)
                want = run_mlp(network.double(), code)
            found[f"query, {grids} grids"] = {"value": error_of(got, want)}
        n, count, width = max(scale // 16, 40), 12, 32
        t = torch.rand(n, count, generator=generator).cumsum(1)
        tau = torch.rand(n, count, generator=generator) ** 6 * 4
        share = torch.rand(n, count, generator=generator) * -torch.expm1(-tau)
        front = torch.exp(-(tau.cumsum(1) - tau))
        features = torch.randn(n, count, width + 1, generator=generator)
        grads = [torch.randn(n, count, generator=generator) for _ in range(2)] + [torch.randn(n, width + 3, generator=generator)]
        sets = []
        for gathering, dtype in ((gather, torch.float32), (gather_reference, torch.float64)):
            a, b, c, f = (v.to(device, dtype, copy=True).requires_grad_() for v in (tau, share, front, features))
            one, times = torch.zeros(n, dtype=torch.long, device=device), t.to(device, dtype)
            done = gathering(Strands(one, times, times, f[..., 1:], a, b, times[..., None], one), c)
            torch.autograd.backward(done, [g.to(device, dtype) for g in grads])
            sets.append([*(v.detach() for v in done), a.grad, b.grad, c.grad, f.grad])
        of_gather = ("weights", "times", "sums", "tau grad", "share grad", "front grad", "feature grad")
        found["gather"] = {k: error_of(a, b) for k, a, b in zip(of_gather, *sets, strict=True)}
        values = (torch.rand(40, 32, 16, generator=generator) < 0.15).to(torch.uint8) * 200
        voxels = Voxels(values.to(device), torch.tensor([-10.0, -8.0, 0.0], device=device), 0.5)
        lower = torch.tensor([-10.0, -8.0, 0.0])
        o = torch.rand(n, 3, generator=generator) * torch.tensor([20.0, 16.0, 8.0]) + lower
        d = torch.nn.functional.normalize(torch.randn(n, 3, generator=generator), dim=-1)
        near, far = torch.full((n,), 0.1), torch.rand(n, generator=generator) * 12 + 0.2
        segment = Segment(*(v.to(device) for v in (o, d, near, far)))
        u = ((torch.arange(16) + torch.rand(n, 16, generator=generator)) / 16).contiguous().to(device)
        (_, mass), (_, want_mass) = propose(voxels, segment, u), propose_reference(voxels, segment, u)
        found["propose"] = {"mass": error_of(mass, want_mass.double())}
        from unisim_blender.core.on_gpu.probe import probe

        probe(device)
    finally:
        triton.runtime.jit.KernelInterface.__getitem__ = original
        vars(kernel_choice)["ready"] = before
    worst = {name: max(errors.values()) for name, errors in found.items()}
    wrong = sorted(name for name, error in worst.items() if not error <= KERNEL_BOUND)
    never = sorted(kernel_names() - launched)
    if wrong:
        raise ValueError(f"kernels differ from torch by more than {KERNEL_BOUND:g}: {json.dumps({n: found[n] for n in wrong})}")
    return {"bound": KERNEL_BOUND, "worst": worst, "errors": found, "not_launched": never}


def make_street(out: Path, size: tuple[int, int], frames: int) -> dict[str, Any]:
    """Write the log of a street; return its folder."""
    from unisim_blender.core.street.street import build_street
    from unisim_blender.core.street.write import write_log

    street = build_street(0, frames, *size, ("front_camera",), 0.01, "exact", 1)
    write_log(street, out / "street", os.cpu_count() or 1, progress=False)
    return {"folder": str(out / "street"), "frames": frames, "size": size}


def clock(device: str, work: Callable[[], object]) -> float:
    """Return the milliseconds that some work takes, by CUDA's events on a GPU."""
    import torch

    if device != "cuda":
        begun = time.perf_counter()
        work()
        return 1000 * (time.perf_counter() - begun)
    first, last = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
    first.record()
    work()
    last.record()
    torch.cuda.synchronize()
    return float(first.elapsed_time(last))


def median_ms(device: str, work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the median of some rounds after one that does not count, in milliseconds."""
    work()
    return round(statistics.median(clock(device, work) for _ in range(rounds)), 3)


def train_and_time(
    out: Path, preset: str, device: str, seconds: float, report: Report, qualities: tuple[str, ...], rounds: int
) -> dict[str, Any]:
    """Train a scene for some seconds; return steps, quality, times of steps, images and sweeps, and profiles."""
    import numpy as np
    import torch

    from unisim_blender.core.evaluate.recorded import recorded_picture
    from unisim_blender.core.logs import open_log
    from unisim_blender.core.quality import QUALITY
    from unisim_blender.core.render import Renderer
    from unisim_blender.core.torch_tracer import TorchTracer
    from unisim_blender.core.training.config import TrainConfig
    from unisim_blender.core.training.run import _as_scene, finish
    from unisim_blender.core.training.trainer import Trainer

    log = open_log(out / "street")
    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()
    frames = tuple(log.drive.frames)
    lidars = tuple(name for name, lidar in log.drive.lidars.items() if lidar.model.beams)
    config = TrainConfig(("front_camera",), lidars, frames[::2], preset=preset, minutes=seconds / 60, device=device)
    trainer = Trainer(log, config)
    begun, steps, figures = time.monotonic(), 0, {}
    while trainer.progress < 1:
        figures = trainer.step()
        trainer.elapsed_s, steps = time.monotonic() - begun, steps + 1
    found: dict[str, Any] = {"steps": steps, "steps_per_s": steps / trainer.elapsed_s, "last": figures}
    found["step_ms"] = median_ms(device, trainer.step, rounds)
    found["profile_step"] = profile(device, trainer.step, out / f"step_{preset}.json")
    folder = out / preset
    folder.mkdir(exist_ok=True)
    finish(trainer, folder)
    scene, held_out = _as_scene(trainer, folder), frames[1]
    drive = scene.header.drive
    recorded = recorded_picture(log, "front_camera", held_out, None)
    for quality in qualities or QUALITY:
        if report.left_s() < 20:
            break
        renderer = Renderer(TorchTracer(scene, drive, quality), drive)
        rgb = renderer.camera("front_camera", held_out).rgb
        error = float(np.mean((rgb - np.asarray(recorded, np.float32)) ** 2))
        times = {"image_ms": median_ms(device, lambda r=renderer: r.camera("front_camera", held_out), rounds)}  # type: ignore[misc]
        for lidar in lidars[:1]:
            times["sweep_ms"] = median_ms(device, lambda r=renderer, name=lidar: r.lidar(name, held_out), rounds)  # type: ignore[misc]
        found[quality] = {"psnr_db": round(-10 * float(np.log10(error)), 2), **times}
        if "profile_image" not in found:
            found["profile_image"] = profile(device, lambda r=renderer: r.camera("front_camera", held_out), None)  # type: ignore[misc]
    if device == "cuda":
        found["peak_bytes"] = torch.cuda.max_memory_allocated()
    return found


def profile(device: str, work: Callable[[], object], trace: Path | None) -> list[dict[str, Any]]:
    """Return the 25 operations that took the most time, in milliseconds; write Chrome's trace where it is under 20 MB."""
    from torch.profiler import ProfilerActivity
    from torch.profiler import profile as torch_profile

    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if device == "cuda" else [])]
    with torch_profile(activities=activities) as measured:
        work()

    def spent_us(row: Any) -> float:
        return float(row.self_device_time_total if device == "cuda" else row.self_cpu_time_total)

    rows = sorted(measured.key_averages(), key=spent_us, reverse=True)[:25]
    if trace is not None:
        measured.export_chrome_trace(str(trace))
        if trace.stat().st_size > 20_000_000:
            trace.unlink()
    return [{"name": row.key[:120], "ms": round(spent_us(row) / 1000, 3), "calls": row.count} for row in rows]


@click.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of gpu.json and of what is made on the way.")
@click.option("--device", default="cuda", show_default=True)
@click.option("--budget", default=600.0, show_default=True, help="Seconds in all.")
@click.option("--seconds", default=60.0, show_default=True, help="Of each training.")
@click.option("--size", nargs=2, type=int, default=(1920, 1080), show_default=True, help="Of the street's images, pixels.")
@click.option("--frames", default=6, show_default=True, help="Of the street.")
@click.option("--samples", default=200_000, show_default=True, help="Of each kernel's comparison.")
@click.option("--qualities", multiple=True, help="Of images and sweeps; all by default.")
@click.option("--rounds", default=ROUNDS, show_default=True, help="That a time is the median of.")
def main(
    out: Path,
    device: str,
    budget: float,
    seconds: float,
    size: tuple[int, int],
    frames: int,
    samples: int,
    qualities: tuple[str, ...],
    rounds: int,
) -> None:
    """Run all stages; exit with 1 where one failed."""
    out.mkdir(parents=True, exist_ok=True)
    report = Report(out / "gpu.json", budget)
    report.stage("machine", lambda: machine(device))
    report.stage("native", lambda: build_native(out))
    report.stage("kernels", lambda: compare_kernels(device, samples))
    if report.stage("street", lambda: make_street(out, size, frames)) is not None:
        for preset in PRESETS:
            report.stage(preset, lambda name=preset: train_and_time(out, name, device, seconds, report, qualities, rounds))  # type: ignore[misc]
    sys.exit(1 if report.values["failed"] else 0)


if __name__ == "__main__":
    main()
