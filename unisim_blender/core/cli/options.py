"""Arguments and options that commands share: sources by paths or URLs, and what is rendered and how."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ..prepare.scenario_plan import RenderOptions
from ..prepare.selection import split_names
from ..remote.requests import is_url
from ..render.quality import QUALITIES
from ..scenes.recipe import pick_device


class SourceParam(click.Path):
    """A path, or the text of a URL."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if is_url(value) else super().convert(value, param, ctx)


def render_options(
    owner: str,
    renderers: Sequence[str] | None = None,
    width: str = "Width of the images.",
    renderer: str = "As of `unisim render`.",
    scene: str = "",
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command the options of what it renders, and how, as one argument ``options``: a
    `RenderOptions`.

    The help says that ``owner`` has the defaults: "the scenario's". ``width``, ``renderer`` and ``scene`` are the help of the
    options of these names; ``renderers`` are the names that are taken, None for any.
    """
    kind: dict[str, Any] = {"metavar": "NAME"} if renderers is None else {"type": click.Choice(list(renderers))}
    shared = (
        click.option("--sensors", metavar="A,B", help=f"Cameras and LiDARs by name. [default: all of {owner}]"),
        click.option("--width", type=click.IntRange(min=8), help=f"{width} [default: the cameras' own]"),
        click.option(
            "--quality", type=click.Choice(list(QUALITIES)), help=f"Samples per ray. [default: {owner}, or balanced]"
        ),
        click.option("--renderer", help=renderer, **kind),
        click.option("--scene", type=SourceParam(), help=f"A trained scene, in place of {scene or owner}."),
        click.option(
            "--device", default="cpu", show_default=True, help="cpu, cuda, cuda:1, mps, or auto for the best there is."
        ),
    )

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def command(
            sensors: str | None,
            width: int | None,
            quality: str | None,
            renderer: str | None,
            scene: Path | str | None,
            device: str,
            **others: Any,
        ) -> None:
            options = RenderOptions(
                sensors=split_names(sensors),
                width=width,
                quality=quality,
                device=pick_device(device),
                renderer=renderer,
                scene=scene,
            )
            function(options=options, **others)

        for option in reversed(shared):
            command = option(command)
        return command

    return decorate
