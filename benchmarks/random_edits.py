"""Random edits of a scenario, each rendered over the folder of the edit before and afresh: the bytes
have to be the same.

python benchmarks/random_edits.py sample/scenario.json out/edits --count 200 --seed 0

Prints a line for each edit and one in the end: captures rendered again, kept, and folders whose bytes differ; exits
1 where any does.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from rendered_folder import contents

from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.sequence.run import RenderReport, render_sequence

Edit = dict[str, Any]


def random_edit(rng: np.random.Generator, actors: list[str], number: int) -> Edit:
    """Return an edit of a kind drawn at random."""
    actor, other = (str(name) for name in rng.choice(actors, 2, replace=False))
    new = f"new-{number}"
    pose = {
        "position": [float(rng.uniform(-40, 80)), float(rng.uniform(-12, 12)), 0.8],
        "yaw_deg": float(rng.uniform(-180, 180)),
    }
    start = float(rng.uniform(0.0, 1.2))
    present = {"start_s": start, "end_s": start + float(rng.uniform(0.1, 0.7))}
    kinds: list[Edit] = [
        {"type": "remove", "actor": actor},
        {"type": "insert", "actor": actor, "id": new, "pose": pose, "present": present},
        {"type": "swap", "actor": actor, "appearance": other},
        {"type": "duplicate", "actor": actor, "id": new, "offset_m": [0, float(rng.uniform(-6, 6)), 0]},
        {"type": "scale", "actor": actor, "factors": [float(x) for x in rng.uniform(0.7, 1.4, 3)]},
        {"type": "retime", "actor": actor, "offset_s": float(rng.uniform(-0.8, 0.8)), "outside": "hold"},
    ]
    return kinds[int(rng.integers(len(kinds)))]


def rendered(document: dict[str, Any], beside: Path, out: Path, options: RenderOptions, resume: bool) -> RenderReport:
    """Render a scenario's document, whose paths are relative to those of the file ``beside``."""
    path = beside.with_name(f".random_edits_{beside.name}")
    path.write_text(json.dumps(document))
    try:
        plan, _ = plan_scenario(path, options)
        return render_sequence(plan, out, resume=resume)
    finally:
        path.unlink()


@click.command(help=__doc__)
@click.argument("scenario", type=click.Path(path_type=Path, exists=True))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--count", default=200)
@click.option("--seed", default=0)
@click.option("--frames", default="::4")
@click.option("--width", default=64)
@click.option("--check-every", default=1, help="how often a fresh render is compared")
def main(scenario: Path, out: Path, count: int, seed: int, frames: str, width: int, check_every: int) -> None:
    """Run them."""
    rng, document = np.random.default_rng(seed), json.loads(scenario.read_text())
    options = RenderOptions(frames=frames, width=width, passes=("rgb", "depth", "instance"))
    plan, prepared = plan_scenario(scenario, options)
    taken = {edit["actor"] for edit in document["edits"] if "actor" in edit}
    actors = [uid for uid in prepared.recorded.actors if uid not in taken]
    shutil.rmtree(out, ignore_errors=True)
    rendered(document, scenario, out / "edited", options, resume=False)
    again = kept = differ = 0
    for number in range(count):
        # one edit at a time, in place of the one before: what it took away comes back
        edit = random_edit(rng, actors, number)
        edited = {**document, "edits": [*document["edits"], edit]}
        report = rendered(edited, scenario, out / "edited", options, resume=True)
        again, kept = again + report.captures, kept + report.captures_kept
        same = "not compared"
        if number % check_every == 0:
            shutil.rmtree(out / "fresh", ignore_errors=True)
            rendered(edited, scenario, out / "fresh", options, resume=False)
            is_same = contents(out / "edited") == contents(out / "fresh")
            same, differ = ("same bytes" if is_same else "DIFFERENT"), differ + (not is_same)
        print(
            f"{number:4} {json.dumps(edit)[:90]:90} {report.captures:3} again {report.captures_kept:3} kept  {same}",
            flush=True,
        )
    print(f"{count} edits: {again} captures rendered again, {kept} kept, {differ} folders differ")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
