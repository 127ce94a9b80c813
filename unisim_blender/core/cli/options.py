"""Arguments and options that commands share: sources by paths or URLs, and what is rendered and how."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, get_args

import click
from click.decorators import FC

from ..data.log import Log
from ..data.moved import Choice
from ..prepare.scenario_plan import RenderOptions
from ..prepare.selection import split_names
from ..progress import Bar
from ..remote.requests import is_url
from ..render.quality import QUALITIES
from ..scenes.recipe import pick_device

PATH = click.Path(path_type=Path)
QUALITY = click.Choice(list(QUALITIES))


class SourceParam(click.Path):
    """A path, or the text of a URL."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if is_url(value) else super().convert(value, param, ctx)


def out_option(about: str = "Folder to write; it must be empty or not be there.") -> Callable[[FC], FC]:
    """Return the option that names what a command writes."""
    return click.option("--out", required=True, type=PATH, help=about)


def posed(log: Log, poses: Choice, quiet: bool) -> Log:
    """Return a log with the poses that the option ``--poses`` chooses; a bar shows progress, and what they are is
    said."""
    from ..poses.posed import posed_log

    with Bar(total=100, unit="%", desc="poses", delay=0.5, disable=quiet) as bar:
        chosen = posed_log(log, poses, lambda share: bar.update(round(100 * share) - bar.n))
    for sentence in chosen.sentences:
        click.echo(sentence, err=True)
    return chosen.log


BOXES_HELP = "A file of boxes in place of the log's own."


def boxes_option(argument: str) -> Callable[[FC], Callable[..., None]]:
    """Return a decorator that gives a command the option ``--boxes``: its ``argument``, a log, is then opened with the
    boxes of that file."""

    def decorate(function: Callable[..., Any]) -> Callable[..., None]:
        @functools.wraps(function)
        def command(boxes: Path | None, **given: Any) -> None:
            if boxes is not None:
                from ..formats.boxes import with_boxes

                given[argument] = with_boxes(given[argument], boxes)
            function(**given)

        return click.option("--boxes", type=PATH, help=BOXES_HELP)(command)

    return decorate


def poses_option(default: Choice) -> Callable[[FC], FC]:
    """Return the option that chooses the ego's trajectory: the argument of `posed`."""
    return click.option(
        "--poses",
        type=click.Choice(get_args(Choice)),
        default=default,
        show_default=True,
        help="The ego's trajectory: the log's; refined by its sweeps; or auto, refined where the log's drifts.",
    )


def render_options(
    owner: str,
    renderers: Sequence[str] | None = None,
    width: str = "Width of the images.",
    renderer: str = "As of `unisim render`.",
    scene: str = "",
    without: Collection[str] = (),
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command the options of what it renders, and how, as one argument ``options``: a
    `RenderOptions`.

    The help says that ``owner`` has the defaults: "the scenario's". ``width``, ``renderer`` and ``scene`` are the help of the
    options of these names; ``renderers`` are the names that are taken, None for any; options ``without`` are left out.
    """
    kind: dict[str, Any] = {"metavar": "NAME"} if renderers is None else {"type": click.Choice(list(renderers))}
    every = {
        "sensors": click.option(
            "--sensors", metavar="A,B", help=f"Cameras and LiDARs by name. [default: all of {owner}]"
        ),
        "width": click.option("--width", type=click.IntRange(min=8), help=f"{width} [default: the cameras' own]"),
        "quality": click.option("--quality", type=QUALITY, help=f"Samples per ray. [default: {owner}, or balanced]"),
        "fill": click.option(
            "--fill",
            metavar="NAME",
            help="texture: ground and façades that nobody saw have the texture of the street around them; learned: a "
            f"network draws on images after that; or another fixer's name, or module:function. [default: {owner}, or none]",
        ),
        "detail": click.option(
            "--detail/--no-detail",
            default=None,
            help="Whether images of a trained scene get the detail of recorded images near by, which the log must have. "
            f"[default: {owner}, or not]",
        ),
        "renderer": click.option("--renderer", help=renderer, **kind),
        "scene": click.option("--scene", type=SourceParam(), help=f"A trained scene, in place of {scene or owner}."),
        "boxes": click.option("--boxes", type=PATH, help=f"{BOXES_HELP} Not with a trained scene, which has its own."),
        "device": click.option(
            "--device", default="cpu", show_default=True, help="cpu, cuda, cuda:1, mps, or auto for the best there is."
        ),
    }
    shared = {name: option for name, option in every.items() if name not in without}

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def command(**given: Any) -> None:
            own = {name: given.pop(name) for name in shared}
            own |= {"sensors": split_names(own["sensors"]), "device": pick_device(own["device"])}
            function(options=RenderOptions(**own), **given)

        for option in reversed(shared.values()):
            command = option(command)
        return command

    return decorate
