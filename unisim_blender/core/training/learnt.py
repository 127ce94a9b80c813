"""The scene that a training leaves: read where it is there, learnt where it is not, gone on with where it was cut off."""

from __future__ import annotations

from pathlib import Path

from ..errors import SceneError
from ..log import Log
from ..scene_file import HEADER_NAME, SceneHeader, read_scene_header
from .config import TrainConfig


def learnt(log: Log, config: TrainConfig, folder: Path, quiet: bool = False) -> SceneHeader:
    """``log``'s scene in ``folder``, trained by ``config`` if it is not yet. Raises SceneError where another was trained there;
    KeyboardInterrupt leaves a checkpoint."""
    if (folder / HEADER_NAME).is_file():
        header = read_scene_header(folder)
        _check(header, config)
        return header
    # torch takes seconds to import, and reading what is learnt needs none
    from .run import CHECKPOINT, train

    return train(log, config, folder, resume=(folder / CHECKPOINT).is_file(), quiet=quiet)


def _check(header: SceneHeader, config: TrainConfig) -> None:
    wanted = {name: getattr(config, name) for name in ("preset", "without", "cameras", "frames", "width", "seed")}
    wanted["disturbed"] = config.noise
    for name, asked in wanted.items():
        asked, found = list(asked) if isinstance(asked, tuple) else asked, header.training.get(name)
        if asked != found:
            raise SceneError(f"{header.path}: was trained with {name} {found}, not {asked}: give another folder")
