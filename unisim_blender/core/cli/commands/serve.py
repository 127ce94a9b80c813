"""`unisim serve`: scenes as AlpaSim's `sensorsim` service."""

from __future__ import annotations

from pathlib import Path

import click

from ...errors import UnisimError
from ...prepare.scenario_plan import RenderOptions
from ..options import PATH, render_options


@click.command("serve")
@click.argument("scenes", nargs=-1, required=True, type=PATH)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option("--port", default=6011, show_default=True, type=click.IntRange(0, 65535), help="0 takes a free one.")
@click.option("--tls-cert", type=PATH, help="Certificate (PEM): calls come through TLS.")
@click.option("--tls-key", type=PATH, help="The certificate's private key (PEM).")
@click.option("--token-file", type=PATH, help="File with the token that callers have to state.")
@click.option(
    "--timeout",
    "timeout_s",
    default=300.0,
    show_default=True,
    type=click.FloatRange(0.1, 3600.0),
    help="Seconds that a call takes at most.",
)
@render_options("the scenarios'", without=("width", "scene", "boxes"))
def command(
    scenes: tuple[Path, ...],
    host: str,
    port: int,
    tls_cert: Path | None,
    tls_key: Path | None,
    token_file: Path | None,
    timeout_s: float,
    options: RenderOptions,
) -> None:
    """Serve SCENES, scenarios, logs or trained scenes, to AlpaSim and other clients of its renderer's service."""
    from ...formats.alpasim.endpoints import read_file
    from ...serve.scenes import open_scenes
    from ...serve.server import Listening, serve_until_signalled

    token = None
    if token_file is not None:
        try:
            token = read_file(token_file).decode().strip()
        except UnicodeDecodeError as error:
            raise UnisimError(f"{token_file}: is no text") from error
    where = Listening(host, port, tls_cert, tls_key, token)
    opened = open_scenes(scenes, options)
    for scene in opened.values():
        for sentence in scene.warnings:
            click.echo(f"Warning: {scene.scene_id}: {sentence}", err=True)

    def ready(bound: int) -> None:
        click.echo(f"Serving {', '.join(opened)} at {host}:{bound}; stop with Ctrl-C")

    serve_until_signalled(opened, where, timeout_s, ready)
    click.echo("Stopped.")
