"""The commands whose files are compared. Each is one call of the command line `unisim`."""

from __future__ import annotations

from dataclasses import dataclass, field

INSTRUCTION_SETS = ("portable", "avx2", "avx512")
QUALITIES = ("fast", "balanced", "fine", "reference")
TORCH = {"UNISIM_NATIVE": "0"}


@dataclass(frozen=True)
class Case:
    """Arguments of `unisim`, with ``{inputs}`` for the folder of scenarios, ``{made}`` for that of what the base made in cases
    before, and ``{out}`` for the case's own folder. ``after`` are the cases whose files it reads.

    ``same_as`` names a case whose files must be the same in each tree by itself. ``instruction_set`` is the one that the case is
    for: it is skipped where the machine has none. ``prints``: what it prints is compared, too.
    """

    name: str
    arguments: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)
    after: tuple[str, ...] = ()
    same_as: str = ""
    instruction_set: str = ""
    prints: bool = False
    quick: bool = False


def _render(
    name: str,
    scenario: str,
    *more: str,
    environment: dict[str, str] | None = None,
    after: tuple[str, ...] = (),
    same_as: str = "",
    instruction_set: str = "",
    jobs: int = 1,
    quick: bool = False,
) -> Case:
    arguments = ("render", f"{{inputs}}/{scenario}.json", "--out", "{out}/frames", "--jobs", str(jobs), *more)
    variant = {"UNISIM_NATIVE_VARIANT": instruction_set} if instruction_set else {}
    return Case(name, arguments, {**(environment or {}), **variant}, after, same_as, instruction_set, quick=quick)


def _made() -> list[Case]:
    """Logs and scenes made anew by both trees; later cases read the base's. After so few steps a scene has rough shapes, and
    hardly any colours."""
    street = ("synth", "{out}/log", "--frames", "4", "--width", "96", "--height", "54", "--jobs", "1", "--quiet")
    cases = [Case("synth", street, quick=True)]
    for preset, steps in (("tiny", 200), ("ngp", 60), ("nsg", 60)):
        train = (
            "train",
            "{made}/synth/log",
            "--out",
            "{out}/scene",
            "--preset",
            preset,
            "--iterations",
            str(steps),
            "--quiet",
        )
        cases.append(Case(f"train {preset}", (*train, "--frames", "::1"), after=("synth",)))
    blind = (
        "train",
        "{made}/synth/log",
        "--out",
        "{out}/scene",
        "--preset",
        "ngp",
        "--iterations",
        "20",
        "--without",
        "lidar",
    )
    cases.append(Case("train ngp without lidar", (*blind, "--frames", "::1", "--quiet"), after=("synth",)))
    return cases


def _compiled() -> list[Case]:
    """The compiled tracer: instruction sets, qualities, edits, processes, threads."""
    size = ("--width", "160")
    cases = []
    for name in INSTRUCTION_SETS:
        for quality in QUALITIES:
            some = ("--frames", "12" if quality == "reference" else "3,12", "--quality", quality)
            cases.append(_render(f"{name} {quality}", "edited", *size, *some, instruction_set=name))
        cases.append(
            _render(f"{name} busy", "busy", *size, "--frames", "1,9", instruction_set=name, quick=name == "portable")
        )
        sweep = ("--frames", "7", "--sensors", "pandar64,front_camera", "--width", "480")
        cases.append(_render(f"{name} unedited", "plain", *sweep, instruction_set=name))
    some = (*size, "--frames", "2:14:4")
    cases += [
        _render("edited", "edited", *some, quick=True),
        _render("edited, 3 jobs", "edited", *some, jobs=3, same_as="edited", quick=True),
        _render("edited, 3 threads", "edited", *some, environment={"OMP_NUM_THREADS": "3"}, same_as="edited"),
        _render("busy", "busy", *some, quick=True),
        _render("busy, 3 jobs", "busy", *some, jobs=3, same_as="busy"),
        _render("busy, whole drive", "busy", "--width", "64", "--quality", "fast"),
        _render("drawn returns", "edited", "--frames", "5", "--sensors", "few", "--draw", "7"),
        _render("two passes", "edited", "--frames", "3", "--width", "96", "--passes", "rgb,support"),
        _render(
            "max error", "edited", "--width", "64", "--frames", "12", "--max-error", "38dB", "--max-error", "p90:50mm"
        ),
        _render(
            "max error, busy",
            "busy",
            "--width",
            "48",
            "--frames",
            "9",
            "--max-error",
            "25dB",
            "--sensors",
            "front_camera",
        ),
        _render("as a log", "plain", "--frames", "3,4", "--width", "96", "--format", "pandaset"),
        _render("on its log", "replayed", "--width", "160", "--frames", "1,3", after=("synth",)),
    ]
    return cases


def _torch() -> list[Case]:
    """Plain torch, the reference."""
    size = ("--width", "48")
    cases = [
        _render(f"torch {quality}", "edited", *size, "--frames", "12", "--quality", quality, environment=TORCH)
        for quality in QUALITIES
    ]
    few = (*size, "--frames", "1,9", "--quality", "fast")
    return [
        *cases,
        _render(
            "torch two passes", "edited", "--frames", "3", "--width", "48", "--passes", "rgb,support", environment=TORCH
        ),
        _render("torch busy", "busy", *few, environment=TORCH, quick=True),
        _render("torch busy, 3 jobs", "busy", *few, environment=TORCH, jobs=3, same_as="torch busy"),
    ]


def _trained() -> list[Case]:
    """Scenes of other shapes and methods. What the compiled tracer does not take is torch's, with the compiled kernels."""
    cases = []
    for method, environments in (
        ("tiny", {"": {}, " torch": TORCH, " portable": {"UNISIM_NATIVE_VARIANT": "portable"}}),
        ("ngp", {"": {}, " torch": TORCH}),
        ("nsg", {"": {}, " torch": TORCH}),
    ):
        after = ("synth", f"train {method}")
        scene = ("--scene", f"{{made}}/train {method}/scene", "--width", "48")
        for name, environment in environments.items():
            cases.append(
                _render(
                    f"{method}{name}", "log-edited", *scene, "--frames", "1,2", environment=environment, after=after
                )
            )
        cases.append(
            _render(f"{method}, 3 jobs", "log-edited", *scene, "--frames", "1,2", jobs=3, after=after, same_as=method)
        )
        cases.append(_render(f"{method} unedited", "log", *scene, "--frames", "2", "--quality", "fast", after=after))
    after = ("synth", "train tiny")
    tiny = ("--scene", "{made}/train tiny/scene", "--frames", "2", "--width", "48")
    cases += [
        _render("tiny, a guest", "log-guest", *tiny, after=after),
        _render("tiny, a guest, torch", "log-guest", *tiny, environment=TORCH, after=after),
        _render("tiny, max error", "log", *tiny, "--max-error", "15dB", after=after),
        Case(
            "eval",
            ("eval", "{made}/train tiny/scene", "{made}/synth/log", "--out", "{out}/figures", "--frames", "1"),
            after=after,
        ),
        Case("info", ("info", "{made}/train tiny/scene", "--json"), after=after, prints=True),
    ]
    return cases


def _untrained() -> list[Case]:
    """Renderers that need no trained scene."""
    cases, after = [], ("synth",)
    for name in ("surfel", "warp"):
        size = ("--renderer", name, "--width", "160", "--frames", "1,2")
        cases += [
            _render(name, "log", *size, after=after, quick=name == "surfel"),
            _render(f"{name} edited", "log-edited", *size, after=after),
            _render(f"{name} edited, 3 jobs", "log-edited", *size, jobs=3, after=after, same_as=f"{name} edited"),
            _render(f"{name} portable", "log-edited", *size, after=after, instruction_set="portable"),
        ]
    cases.append(
        _render(
            "surfel of two frames",
            "log",
            "--renderer",
            "surfel",
            "--width",
            "96",
            "--frames",
            "1",
            "--sources",
            "0,2",
            after=after,
        )
    )
    return cases


CASES = {case.name: case for case in (*_made(), *_compiled(), *_torch(), *_trained(), *_untrained())}
"""By their names, in the order in which they run."""


def chosen(names: tuple[str, ...], quick: bool) -> list[Case]:
    """The cases whose names contain one of ``names`` (all where there is none), the quick ones alone where asked for, and those
    that they read from. Raises KeyError for a name that no case has."""
    for name in names:
        if not any(name in case for case in CASES):
            raise KeyError(name)
    wanted = {
        name
        for name, case in CASES.items()
        if (case.quick or not quick) and (not names or any(part in name for part in names))
    }
    while more := {name for case in wanted for name in (*CASES[case].after, CASES[case].same_as) if name} - wanted:
        wanted |= more
    return [case for name, case in CASES.items() if name in wanted]
