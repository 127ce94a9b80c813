"""The scene that a training leaves: loaded where it is finished, trained where it is missing, resumed
where it was cut off."""

from __future__ import annotations

from pathlib import Path

from ..data.log import Log
from ..errors import SceneError
from ..model.scene_file import HEADER_NAME, SceneHeader, read_scene_header
from .config import TrainConfig, recipe


def load_or_train(log: Log, config: TrainConfig, folder: Path, quiet: bool = False) -> SceneHeader:
    """``log``'s scene in ``folder``, trained by ``config`` if it is not yet. Raises SceneError where another was
    trained there; KeyboardInterrupt leaves a checkpoint."""
    if (folder / HEADER_NAME).is_file():
        header = read_scene_header(folder)
        _check(header, config)
        return header
    # torch takes seconds to import, and reading a trained scene needs none
    from .checkpoint import CHECKPOINT
    from .loop import train

    return train(log, config, folder, resume=(folder / CHECKPOINT).is_file(), quiet=quiet)


def _check(header: SceneHeader, config: TrainConfig) -> None:
    names = ("preset", "without", "cameras", "frames", "width", "seed", "adversarial")
    asked = {name: getattr(config, name) for name in names} | {"disturbed": config.noise}
    stated = {name: header.training.get(name) for name in asked}
    asked["density"], stated["density"] = recipe(config).model.density, header.model.get("density")
    # of a budget in minutes the steps follow, of one in steps the minutes
    budget = "minutes" if config.iterations is None else "iterations"
    asked[budget], stated[budget] = getattr(config, budget), header.training.get(budget)
    for name, value in asked.items():
        wanted = list(value) if isinstance(value, tuple) else value
        if wanted != stated[name]:
            was = stated[name]
            raise SceneError(f"{header.path}: was trained with {name} {was}, not {wanted}: give another folder")
