"""A street: its recipe, what stands in it, its drive as it is recorded, and the lenses that its cameras may have.

Each lens has about the parameters of a recorded one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from unisim_blender.core.errors import LogError, in_a_line, short
from unisim_blender.core.formats.pandaset.sensors import CAMERAS, PANDAR64, ROLLING_SHUTTER, ego_from_lidar, pandar64
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix
from unisim_blender.core.lenses import PINHOLE
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.scenes.scene import Scene
from unisim_blender.core.world.drive import Camera, CameraModel, Drive, Lidar

from .assets.road import MAX_TURN_DEG, Course, RoadPlan
from .layout import FRAME_S, SPEED_M_S, StreetKind, ego_poses, lay_out
from .paint.light import DAY, StreetLight, night
from .tracing.trace import Asset


@dataclass(frozen=True)
class StreetLens:
    """A lens, and how many degrees an image's width spans through it; None: as many as without it."""

    lens: Lens
    across_deg: float | None = None


DEFAULT_LENS = "pinhole"
STREET_LENSES = {
    DEFAULT_LENS: StreetLens(PINHOLE),
    "opencv": StreetLens(OpenCVPinhole(k1=-0.24, k2=0.09, p1=4e-4, p2=-3e-4, k3=-0.012)),
    "fisheye": StreetLens(OpenCVFisheye(k1=-0.02, k2=0.004, k3=-0.003, k4=4e-4, max_angle_deg=105.0), 150.0),
    "ftheta": StreetLens(FTheta(radius_from_angle=(1.0, 0.0, -0.03, 0.004), max_angle_deg=75.0), 120.0),
    "mei": StreetLens(Mei(xi=1.6, k1=-0.03, k2=0.01, p1=3e-4, p2=-2e-4), 185.0),
}
"""By the names that recipes and `unisim synth --lens` have. Where an image reaches beyond what its lens shows, it is black."""


RECIPE_FILE = "street.json"
RECIPE_FORMAT, RECIPE_VERSION = "unisim-street", 1
KINDS = get_args(StreetKind)
"""A straight street by day, which may have bends; the same by night; a curve; a crossing with cars that turn."""
MAX_FRAMES = 1000
MAX_SPEED_M_S, MAX_TURNS, MAX_PEOPLE = 40.0, 20, 100
ENGINES = ("exact", "cycles")
"""Who draws a street: its own renderer, its solids in closed form; or Cycles, its triangles, with
light that bounces."""
FINE_PAINT_REACH_M = 3.5
"""How far beside the recorded trajectory paint is as fine as a camera there needs it."""

MOUNTS: dict[str, tuple[tuple[float, float, float], float, float, float]] = {
    "front_camera": ((0.85, 0.0, 1.81), 0.0, 1970 / 1920, -0.050),
    "front_left_camera": ((1.52, 0.64, 1.53), 57.7, 930 / 1920, -0.061),
    "front_right_camera": ((1.49, -0.60, 1.60), -57.8, 930 / 1920, -0.039),
    "left_camera": ((0.55, 0.54, 1.58), 91.6, 930 / 1920, -0.081),
    "right_camera": ((0.59, -0.70, 1.55), -88.6, 930 / 1920, -0.019),
    "back_camera": ((-0.25, -0.03, 1.65), -178.3, 933 / 1920, -0.100),
}
"""PandaSet's cameras, levelled: place in the ego frame, yaw in degrees, focal length in image widths, seconds
after the sweep."""


@dataclass(frozen=True)
class Recipe:
    """All that a street depends on. ``range_noise_m``: deviation of the recorded LiDAR ranges; the truth has none.

    engine: who draws its images, one of `ENGINES`; paths: how many paths a pixel Cycles traces. lens: its cameras', one of
    `STREET_LENSES`. speed_m_s: the drive's; turns_deg: bends of the street, to the left where positive, see `Course`.
    kind: one of `KINDS`. thin: whether it has wires, masts, railings and fences. lamps: whether a traffic light changes, and the
    car ahead brakes and indicates.
    """

    seed: int = 0
    frames: int = 20
    width: int = 480
    height: int = 270
    cameras: tuple[str, ...] = ("front_camera",)
    range_noise_m: float = 0.01
    engine: str = "exact"
    paths: int = 96
    lens: str = DEFAULT_LENS
    speed_m_s: float = SPEED_M_S
    turns_deg: tuple[float, ...] = ()
    kind: StreetKind = "straight"
    people: int = 0
    thin: bool = False
    lamps: bool = False

    def __post_init__(self) -> None:
        wholes = (
            ("seed", 0, 2**31),
            ("frames", 2, MAX_FRAMES),
            ("width", 16, 8192),
            ("height", 16, 8192),
            ("paths", 1, 65536),
            ("people", 0, MAX_PEOPLE),
        )
        for name, low, high in wholes:
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise LogError(f"a street's {name} is a whole number from {low} to {high}, not {short(value)}")
        unknown = [camera for camera in self.cameras if camera not in MOUNTS]
        if unknown or not self.cameras or len(set(self.cameras)) != len(self.cameras):
            raise LogError(f"a street's cameras are some of {', '.join(CAMERAS)}, each once, not {short(self.cameras)}")
        noise = self.range_noise_m
        if not isinstance(noise, (int, float)) or not math.isfinite(noise) or not 0 <= noise <= 1:
            raise LogError(f"a street's range_noise_m is from 0 to 1 m, not {short(noise)}")
        speed, turns = self.speed_m_s, self.turns_deg
        if not _is_number(speed) or not 1 <= speed <= MAX_SPEED_M_S:
            raise LogError(f"a street's speed_m_s is from 1 to {MAX_SPEED_M_S:g} m/s, not {short(speed)}")
        if len(turns) > MAX_TURNS or not all(_is_number(turn) and 1 <= abs(turn) <= MAX_TURN_DEG for turn in turns):
            raise LogError(
                f"a street's turns_deg are up to {MAX_TURNS} numbers from 1 to {MAX_TURN_DEG:g} degrees, negative to the right, "
                f"not {short(turns)}"
            )
        if self.kind not in KINDS:
            raise LogError(f"a street's kind is one of {', '.join(KINDS)}, not {short(self.kind)}")
        if turns and self.kind in ("curve", "crossing"):
            raise LogError(f"a street with turns_deg is straight or a night, not a {self.kind}")
        if self.engine != "exact" and self.kind == "curve":
            raise LogError("a curve is drawn by the exact engine alone")
        if self.engine != "exact" and (turns or speed != SPEED_M_S):
            raise LogError("a street with turns or another speed is drawn by the exact engine alone")
        for name in ("thin", "lamps"):
            if not isinstance(getattr(self, name), bool):
                raise LogError(f"a street's {name} is true or false, not {short(getattr(self, name))}")
        if self.engine != "exact" and self.lamps:
            raise LogError("a street with lamps is drawn by the exact engine alone")
        if self.engine not in ENGINES:
            raise LogError(f"a street's engine is {' or '.join(ENGINES)}, not {short(self.engine)}")
        if not isinstance(self.lens, str) or self.lens not in STREET_LENSES:
            raise LogError(f"a street's lens is one of {', '.join(STREET_LENSES)}, not {short(self.lens)}")

    @property
    def is_usual(self) -> bool:
        """Whether the street is straight and the drive at the usual speed."""
        return not self.turns_deg and self.speed_m_s == SPEED_M_S and self.kind != "curve"


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True, eq=False)
class Street:
    """A street that is known exactly.

    Its own coordinates ("street frame") are those of the log it writes: ``drive.world_origin`` is added to a drive's.
    ``static`` is what stands above ``ground`` without being annotated, ``assets`` the annotated objects by uid;
    ``others`` are the streets of the trained scenes, by ``Appearance.scene``, that inserted actors come from.
    """

    recipe: Recipe
    drive: Drive
    plan: RoadPlan
    ground: Asset
    static: Asset
    assets: dict[str, Asset]
    light: StreetLight = DAY
    others: Mapping[str, Street] = field(default_factory=dict)
    thin: int = 0
    """How many of the last parts of ``static`` are wires, masts, railings and fences."""

    def ground_height(self, points_xy: FloatArray) -> FloatArray:
        """The known ground's height (N,) at x, y (N, 2), street frame."""
        return self.plan.height(points_xy)

    def with_scene(self, scene: str, street: Street) -> Street:
        """The same street, with actors of the trained scene ``scene`` taken from that scene's street."""
        same = street.recipe == self.recipe
        return replace(self, others={**self.others, scene: self if same else street})


def build_street(
    seed: int = 0,
    frames: int = 20,
    width: int = 480,
    height: int = 270,
    cameras: tuple[str, ...] = ("front_camera",),
    range_noise_m: float = 0.01,
    engine: str = "exact",
    paths: int = 96,
    lens: str = DEFAULT_LENS,
    speed_m_s: float = SPEED_M_S,
    turns_deg: tuple[float, ...] = (),
    kind: StreetKind = "straight",
    people: int = 0,
    thin: bool = False,
    lamps: bool = False,
) -> Street:
    """The street of a recipe, and its recorded drive; the same arguments give the same street, to the bit."""
    turns = tuple(turns_deg)
    recipe = Recipe(
        seed,
        frames,
        width,
        height,
        tuple(cameras),
        range_noise_m,
        engine,
        paths,
        lens,
        speed_m_s,
        turns,
        kind,
        people,
        thin,
        lamps,
    )
    layout = lay_out(seed, frames, speed_m_s, recipe.turns_deg, not recipe.is_usual, kind, people, thin, lamps)
    course = layout.plan.course
    times = FRAME_S * np.arange(frames)
    time_s = {frame: float(times[frame]) for frame in range(frames)}
    ego = Trajectory.from_poses(times, ego_poses(times, speed_m_s, course))
    origin = ego.positions[0].copy()
    world_from_street = np.eye(4)
    world_from_street[:3, 3] = -origin
    world_from_ego = ego.transformed(left=world_from_street)
    actors = {
        uid: replace(actor, world_from_actor=actor.world_from_actor.transformed(left=world_from_street))
        for uid, actor in sorted(layout.actors.items())
    }
    lidar = Lidar(PANDAR64, pandar64(), world_from_ego.transformed(right=ego_from_lidar(PANDAR64)), dict(time_s))
    drive = Drive(
        name=f"{'street' if kind == 'straight' else kind}-{seed}",
        frames=tuple(range(frames)),
        time_s=time_s,
        world_from_ego=world_from_ego,
        cameras={
            name: _camera(name, recipe, course, time_s, world_from_street) for name in CAMERAS if name in recipe.cameras
        },
        lidars={PANDAR64: lidar},
        actors=actors,
        world_origin=origin,
    )
    light = night(layout.lamps) if kind == "night" else DAY
    if engine == "exact":
        return Street(
            recipe, drive, layout.plan, layout.plan.asset(), layout.static, layout.assets, light, thin=layout.thin
        )
    from .assets.meshed import meshed, meshed_ground  # scipy's, which a street of solids in logs can do without

    assets = {uid: meshed(asset) for uid, asset in layout.assets.items()}
    ground, static = meshed_ground(layout.plan), meshed(layout.static)
    return Street(recipe, drive, layout.plan, ground, static, assets, light, thin=layout.thin)


def _camera(
    name: str, recipe: Recipe, course: Course, time_s: dict[int, float], world_from_street: FloatArray
) -> Camera:
    place, yaw_deg, focal, delay_s = MOUNTS[name]
    yaw = np.radians(yaw_deg)
    ego_from_camera = np.eye(4)  # OpenCV's axes: x right, y down, z forward
    ego_from_camera[:3, :3] = np.stack([[np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1], [np.cos(yaw), np.sin(yaw), 0]], 1)
    ego_from_camera[:3, 3] = place
    f = focal * recipe.width
    model = CameraModel(recipe.width, recipe.height, f, f, recipe.width / 2, recipe.height / 2, ROLLING_SHUTTER)
    model = through(model, recipe.lens)
    times = np.array(list(time_s.values())) + delay_s
    poses = world_from_street @ ego_poses(times, recipe.speed_m_s, course) @ ego_from_camera
    keys = Trajectory(times, poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3]))
    return Camera(name, model, keys, {frame: float(times[i]) for i, frame in enumerate(time_s)})


def recipe_document(recipe: Recipe) -> dict[str, Any]:
    """The recipe as a JSON document."""
    document = {"format": RECIPE_FORMAT, "version": RECIPE_VERSION, **asdict(recipe), "cameras": list(recipe.cameras)}
    document["turns_deg"] = list(recipe.turns_deg)
    for name, usual in (
        ("lens", DEFAULT_LENS),
        ("speed_m_s", SPEED_M_S),
        ("turns_deg", []),
        ("kind", KINDS[0]),
        ("people", 0),
        ("thin", False),
        ("lamps", False),
    ):
        if document[name] == usual:
            del document[name]  # as programs from before these were there read and wrote it
    return document


def load_street(path: Path | str) -> Street:
    """The street of a recipe: a `street.json`, or the folder of a log that holds one. `LogError` where
    it is no recipe."""
    path = Path(path)
    file = path / RECIPE_FILE if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LogError(f"{file}: is missing, so no street can be built from {path}") from error
    except (OSError, ValueError, RecursionError) as error:
        raise LogError(f"{file}: is not a street's recipe ({in_a_line(error)})") from error
    if not isinstance(document, dict) or document.get("format") != RECIPE_FORMAT:
        raise LogError(f"{file}: is not a street's recipe, its format is not {RECIPE_FORMAT!r}")
    if document.get("version") != RECIPE_VERSION:
        raise LogError(
            f"{file}: has the recipe version {short(document.get('version'))}, this program reads {RECIPE_VERSION}"
        )
    values = {name: document[name] for name in Recipe.__dataclass_fields__ if name in document}
    unknown = sorted(set(document) - set(values) - {"format", "version"})
    if unknown:
        raise LogError(f"{file}: holds {short(unknown[0])}, which no recipe has")
    for name in ("cameras", "turns_deg"):
        if not isinstance(values.get(name, []), list):
            raise LogError(f"{file}: {name} is no list")
    if "cameras" in values:
        values["cameras"] = tuple(str(camera) for camera in values["cameras"])
    if "turns_deg" in values:
        values["turns_deg"] = tuple(values["turns_deg"])
    try:
        return build_street(**values)
    except LogError as error:
        raise LogError(f"{file}: {error}") from error


def street_origin(world_origin: FloatArray) -> FloatArray:
    """Pose (4, 4) that takes the world of a drive with this origin to the street frame."""
    return make_pose(np.asarray(world_origin, np.float64), np.array([1.0, 0.0, 0.0, 0.0]))


def through(model: CameraModel, name: str) -> CameraModel:
    """Return a pinhole camera with a lens of `STREET_LENSES` instead, its image spanning the degrees that the lens says."""
    chosen = STREET_LENSES[name]
    if chosen.lens == PINHOLE:
        return model
    half = np.arctan(model.width / 2 / model.fx) if chosen.across_deg is None else np.radians(chosen.across_deg) / 2
    plane, _ = chosen.lens.project(np.array([np.sin(half), 0.0, np.cos(half)]))
    focal = float(model.width / 2 / plane[0])
    return replace(model, fx=focal, fy=focal, lens=chosen.lens)


def street_of(street: Street, others: Mapping[str, Scene]) -> Street:
    """Return the street with those of the scenes that actors were inserted from, by their names in `Appearance`. Raises
    `UnisimError`."""
    for name, scene in others.items():
        street = street.with_scene(name, load_street(scene.header.log_path))
    return street
