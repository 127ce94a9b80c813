"""The names of this package that stay: logs, scenarios and their edits, frames in memory and in files, the closed loop.

Nothing is imported before a name is asked for, so that this module can be imported anywhere, in Blender, too.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from .core.errors import UnisimError as UnisimError
    from .core.formats.readers import open_log as open_log
    from .core.prepare.scenario import prepare_scenario as prepare_scenario
    from .core.prepare.scenario_plan import RenderOptions as RenderOptions
    from .core.scenario import edits as edits
    from .core.scenario import load_scenario as load_scenario
    from .core.scenario import save_scenario as save_scenario
    from .core.scenario.simulation import SimulationSpec as SimulationSpec
    from .core.scenario.types import Scenario
    from .core.scenes.scene import open_scene as open_scene
    from .core.sensors.frames import CameraFrame, LidarFrame
    from .core.sequence.run import RenderReport
    from .core.simulation.rollout.run import FinishedRollout
    from .core.simulation.vehicle.actions import Control as Control
    from .core.simulation.vehicle.actions import Plan as Plan

HOMES = {
    "Control": "core.simulation.vehicle.actions",
    "Plan": "core.simulation.vehicle.actions",
    "RenderOptions": "core.prepare.scenario_plan",
    "SimulationSpec": "core.scenario.simulation",
    "UnisimError": "core.errors",
    "edits": "core.scenario",
    "load_scenario": "core.scenario",
    "open_log": "core.formats.readers",
    "open_scene": "core.scenes.scene",
    "prepare_scenario": "core.prepare.scenario",
    "save_scenario": "core.scenario",
}
"""The module of each name that is imported from elsewhere."""
OWN = ("Frames", "render", "simulate")


def __getattr__(name: str) -> Any:
    """Import a name when it is first asked for."""
    if name not in HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f".{HOMES[name]}", __package__), name)
    return value


def __dir__() -> list[str]:
    """Return the names that stay."""
    return sorted((*HOMES, *OWN))


class Frames:
    """The frames of a scenario, or of a log alone, rendered in memory. ``source`` is a path, a URL or a `Scenario`.

    ``recorded`` and ``edited`` are the drives before and after the scenario's edits. Raises `UnisimError`.
    """

    def __init__(self, source: Path | str | Scenario, options: RenderOptions | None = None) -> None:
        from .core.prepare.scenario_plan import RenderOptions, plan_scenario
        from .core.sequence.run import capture_renderer

        plan, prepared = plan_scenario(source, options or RenderOptions())
        self.recorded, self.edited = prepared.recorded, prepared.edited
        self._render = capture_renderer(plan, plan.recipe.load())

    def image(self, camera: str, frame: int | None = None, time_s: float | None = None) -> CameraFrame:
        """Render the image of a camera: of a frame of the log, or at a time in seconds from its first frame."""
        from .core.world.captures import Capture

        sensor = self.edited.cameras[camera]
        capture = Capture.of_frame(sensor, frame) if frame is not None else Capture.at(sensor, _microseconds(time_s))
        return cast("CameraFrame", self._render(capture)())

    def sweep(self, lidar: str, frame: int | None = None, time_s: float | None = None) -> LidarFrame:
        """Render the sweep of a LiDAR: of a frame of the log, or that ends at a time in seconds from its first frame."""
        from .core.world.captures import Capture

        sensor = self.edited.lidars[lidar]
        capture = Capture.of_frame(sensor, frame) if frame is not None else Capture.at(sensor, _microseconds(time_s))
        return cast("LidarFrame", self._render(capture)())


def render(
    source: Path | str | Scenario,
    out: Path | str,
    options: RenderOptions | None = None,
    jobs: int = 1,
    resume: bool = False,
) -> RenderReport:
    """Render a scenario, or a log alone, into a folder, as `unisim render` does. Raises `UnisimError`."""
    from .core.prepare.scenario_plan import RenderOptions, plan_scenario
    from .core.sequence.run import render_sequence

    plan, _ = plan_scenario(source, options or RenderOptions())
    return render_sequence(plan, Path(out), jobs=jobs, resume=resume)


def simulate(
    source: Path | str | Scenario,
    driver: str,
    out: Path | str,
    simulation: SimulationSpec | None = None,
    options: RenderOptions | None = None,
    resume: bool = False,
) -> FinishedRollout:
    """Let a driver drive through a scenario, or a log alone, into a folder, as `unisim drive` does; return its scores.

    ``driver`` is the name of one, or ``module:function``. Raises `UnisimError`.
    """
    from .core.prepare.scenario_plan import RenderOptions
    from .core.scenario.simulation import SimulationSpec
    from .core.simulation.drivers import driver_named
    from .core.simulation.rollout.run import complete
    from .core.simulation.rollout.setup import open_simulation

    asked, options = simulation or SimulationSpec(), options or RenderOptions()
    opened = open_simulation(source, Path(out), options, asked, driver_named(driver), resume)
    return complete(opened, options)


def _microseconds(time_s: float | None) -> int:
    if time_s is None:
        raise ValueError("give a frame or a time")
    return round(time_s * 1e6)
