"""Every lens model: projection after unprojection, the valid domain, the JSON form, bad parameters, and OpenCV's own numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from unisim_blender.core.lenses import LENSES, PINHOLE, lens_from_dict, register
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens, LensError
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye, RadialLens
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.lenses.registry import Pinhole
from unisim_blender.core.sensors.unprojection import shows_something
from unisim_blender.core.world.drive import CameraModel

FOCAL_PX = 1000.0
RANDOM = (Phase.explicit, Phase.reuse, Phase.generate)
"""Shrinking an example would take minutes."""


def within(limit: float) -> st.SearchStrategy[float]:
    return st.floats(-limit, limit, allow_nan=False)


def made(kind: type[Lens], **parameters: st.SearchStrategy[Any]) -> st.SearchStrategy[Lens | None]:
    """Lenses of random parameters, None for those that fold the image next to the axis."""

    def lens(values: dict[str, Any]) -> Lens | None:
        try:
            return kind(**values)
        except LensError as fault:
            assert "fold" in str(fault)
            return None

    return st.fixed_dictionaries(parameters).map(lens)


radial, tangential = within(0.5), within(0.02)
ANY_LENS = st.one_of(
    st.just(PINHOLE),
    made(OpenCVPinhole, k1=radial, k2=radial, p1=tangential, p2=tangential, k3=within(0.1)),
    made(
        OpenCVPinhole, k1=radial, k2=radial, k3=within(0.2), k4=radial, k5=radial, k6=within(0.2), p1=tangential, p2=tangential,
        s1=tangential, s2=within(0.005), s3=tangential, s4=within(0.005),
    ),
    made(OpenCVFisheye, k1=within(0.2), k2=within(0.1), k3=within(0.05), k4=within(0.02)),
    made(OpenCVFisheye, k1=within(0.05), max_angle_deg=st.floats(20, 180)),
    made(FTheta, radius_from_angle=st.tuples(st.floats(0.3, 2), within(0.1), within(0.1), within(0.05))),
    made(
        FTheta, angle_from_radius=st.tuples(st.floats(0.5, 2), within(0.1), within(0.1)), max_angle_deg=st.floats(20, 170),
        linear=st.tuples(st.floats(0.9, 1.1), within(0.02), within(0.02)),
    ),
    made(Mei, xi=st.floats(0, 3), k1=radial, k2=radial, p1=tangential, p2=tangential),
)  # fmt: skip


def directions(lens: Lens, count: int, seed: int = 0, up_to: float = 1.0) -> NDArray[np.float64]:
    """Unit directions in the valid domain, some on its edge and one on the axis."""
    rng = np.random.default_rng(seed)
    most = min(lens.max_angle_rad, math.radians(89)) if isinstance(lens, Pinhole) else lens.max_angle_rad
    angle = most * up_to * np.sqrt(rng.random(count))
    angle[:20], angle[20] = most * up_to, 0.0
    heading = rng.random(count) * 2 * np.pi
    return np.stack([np.sin(angle) * np.cos(heading), np.sin(angle) * np.sin(heading), np.cos(angle)], -1)


@settings(max_examples=300, deadline=None, phases=RANDOM)
@given(ANY_LENS, st.integers(0, 1000))
def test_projection_undoes_unprojection_to_a_millionth_of_a_pixel(lens: Lens | None, seed: int) -> None:
    if lens is None:
        return
    rays = directions(lens, 200, seed)
    plane, valid = lens.project(rays * np.random.default_rng(seed).uniform(0.1, 100, (200, 1)))
    assert valid.all(), np.degrees(lens.max_angle_rad)
    back = lens.unproject(plane)
    assert np.isfinite(back).all()
    assert np.allclose(np.linalg.norm(back, axis=1), 1, atol=1e-12)
    again, valid = lens.project(back)
    assert valid.all()
    # far beyond any image's edge a float64 itself is coarser
    assert np.abs(again - plane).max() * FOCAL_PX < 1e-6 * max(1.0, np.abs(plane).max() / 50)
    # one to one: where the image does not stand still the direction itself comes back
    inner = directions(lens, 200, seed, 0.9)
    assert np.abs(lens.unproject(lens.project(inner)[0]) - inner).max() < 1e-7


@settings(max_examples=100, deadline=None, phases=RANDOM)
@given(ANY_LENS)
def test_nothing_is_seen_beyond_the_valid_domain(lens: Lens | None) -> None:
    if lens is None:
        return
    angle = min(lens.max_angle_rad * 1.001 + 1e-4, math.pi)
    beyond = np.array([[np.sin(angle), 0.0, np.cos(angle)], [0.0, -np.sin(angle), np.cos(angle)]])
    if lens.max_angle_rad < math.pi * 0.999:
        plane, valid = lens.project(beyond)
        assert not valid.any() and np.isnan(plane).all()
    for point in ([np.nan, 0.0, 1.0], [0.0, np.inf, 1.0], [0.0, 0.0, 0.0]):
        plane, ok = lens.project(np.array(point))
        assert not ok and np.isnan(plane).all()
    assert np.isnan(lens.unproject(np.array([[np.nan, 0.0], [0.0, np.inf]]))).all() or lens is PINHOLE
    if isinstance(lens, (OpenCVFisheye, FTheta)):
        assert np.isnan(lens.unproject(np.array([1e6, 1e6]))).all()


@settings(max_examples=100, deadline=None, phases=RANDOM)
@given(ANY_LENS)
def test_a_lens_reads_back_from_json(lens: Lens | None) -> None:
    if lens is not None:
        assert lens_from_dict(json.loads(json.dumps(lens.to_dict()))) == lens
        assert hash(lens_from_dict(lens.to_dict())) == hash(lens)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ("fisheye", "a lens must be an object with a type, not 'fisheye'"),
        ({}, "type: must be one of pinhole, opencv_pinhole, opencv_fisheye, f_theta, mei, not None"),
        ({"type": ["mei"]}, "type: must be one of"),
        ({"type": "brown"}, "not 'brown'"),
        ({"type": "mei", "k3": 1.0}, 'mei: has no parameter "k3", but k1, k2, p1, p2, xi'),
        ({"type": "mei", "xi": -1.0}, "mei: xi must lie between 0 and 100, not -1.0"),
        ({"type": "mei", "xi": math.nan}, "mei: xi must be a finite number, not nan"),
        ({"type": "opencv_pinhole", "k1": "0"}, "opencv_pinhole: k1 must be a finite number, not '0'"),
        ({"type": "opencv_pinhole", "k1": math.inf}, "opencv_pinhole: k1 must be a finite number, not inf"),
        (
            {"type": "opencv_pinhole", "k1": -1e6},
            "opencv_pinhole: the parameters fold or tear the image 0.03 degrees from",
        ),
        ({"type": "opencv_pinhole", "p1": 1e6}, "opencv_pinhole: the parameters fold or tear the image"),
        ({"type": "opencv_fisheye", "k1": True}, "opencv_fisheye: k1 must be a finite number, not True"),
        ({"type": "opencv_fisheye", "max_angle_deg": 0}, "max_angle_deg must lie above 0 and at most at 180, not 0"),
        (
            {"type": "opencv_fisheye", "max_angle_deg": 200},
            "max_angle_deg must lie above 0 and at most at 180, not 200",
        ),
        ({"type": "f_theta"}, "f_theta: needs radius_from_angle or angle_from_radius, and not both"),
        ({"type": "f_theta", "radius_from_angle": [-1.0]}, "f_theta: the parameters fold or tear the image"),
        ({"type": "f_theta", "angle_from_radius": [0.0, 1.0]}, "f_theta: the parameters fold or tear the image"),
        ({"type": "f_theta", "radius_from_angle": 3.0}, "radius_from_angle must be at most 16 finite numbers, not 3.0"),
        ({"type": "f_theta", "radius_from_angle": [1.0, None]}, "finite numbers, not [1.0, None]"),
        ({"type": "f_theta", "radius_from_angle": [0.1] * 17}, "radius_from_angle must be at most 16 finite numbers"),
        ({"type": "f_theta", "radius_from_angle": [[1.0]]}, "must be at most 16 finite numbers, not [[1.0]]"),
        ({"type": "f_theta", "radius_from_angle": [1.0], "linear": [1.0, 0.0]}, "linear must be c, d, e with"),
        ({"type": "f_theta", "radius_from_angle": [1.0], "max_angle_deg": 0.5}, "leaves no image"),
        ({"type": "f_theta", "radius_from_angle": [1.0], "angle_from_radius": [1.0]}, "and not both"),
        ({"type": "mei", "k1": 10**400}, "mei: k1 must be a finite number, not 1000"),
        ({"type": "mei", "xi": 1.0, "p1": 50.0}, "mei: the parameters fold or tear the image"),
        ({"type": "opencv_fisheye", "k1": [1.0, 2.0]}, "opencv_fisheye: k1 must be a finite number, not (1.0, 2.0)"),
        (
            {"type": "opencv_fisheye", "k1": -1e4},
            "opencv_fisheye: the parameters fold or tear the image 0.33 degrees from",
        ),
        ({"type": "pinhole", "k1": 0.0}, 'pinhole: has no parameter "k1", but none'),
        (
            {"type": "f_theta", "radius_from_angle": [1.0], "linear": [0.0, 1.0, 1.0]},
            "linear must be c, d, e with",
        ),
    ],
)
def test_bad_parameters_are_one_clear_sentence(values: object, sentence: str) -> None:
    with pytest.raises(LensError) as fault:
        lens_from_dict(values)
    assert sentence in str(fault.value) and "\n" not in str(fault.value)


@pytest.mark.parametrize("name", ("fx", "fy", "cx", "cy"))
@pytest.mark.parametrize("value", (0.0, -1.0, math.nan, math.inf))
def test_a_focal_length_is_above_0(name: str, value: float) -> None:
    given: dict[str, Any] = {"width": 8, "height": 6, "fx": 5.0, "fy": 5.0, "cx": 4.0, "cy": 3.0, name: value}
    if name in ("cx", "cy") and math.isfinite(value):
        assert getattr(CameraModel(**given), name) == value
        return
    with pytest.raises(LensError, match=rf"^a camera's {name} must be a finite number.*, not {value:g}$"):
        CameraModel(**given)


def test_an_image_beside_the_domain_shows_nothing() -> None:
    lens = OpenCVFisheye(max_angle_deg=30)
    assert shows_something(CameraModel(64, 48, 50.0, 50.0, 32.0, 24.0, lens=lens))
    assert shows_something(CameraModel(64, 48, 50.0, 50.0, -25.0, 24.0, lens=lens))
    assert not shows_something(CameraModel(64, 48, 50.0, 50.0, -27.0, 24.0, lens=lens))
    assert shows_something(CameraModel(64, 48, 50.0, 50.0, -1e5, 24.0))


def test_a_lens_is_registered_once() -> None:
    assert register(Mei) is Mei
    with pytest.raises(ValueError, match="there is a lens 'mei' already"):
        register(type("Other", (Pinhole,), {"TYPE": "mei"}))
    with pytest.raises(ValueError, match="is no class of lenses"):
        register(CameraModel)  # type: ignore[type-var]
    with pytest.raises(ValueError, match="has no TYPE"):
        register(type("Nameless", (RadialLens,), {}))
    assert set(LENSES) == {"pinhole", "opencv_pinhole", "opencv_fisheye", "f_theta", "mei"}


def test_another_packages_lens_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loaded when a file names it; one that cannot be loaded is left out with a warning."""
    (tmp_path / "our_lenses.py").write_text(
        "from dataclasses import dataclass\n"
        "from unisim_blender.core.lenses.registry import Pinhole\n"
        "@dataclass(frozen=True)\n"
        "class Plain(Pinhole):\n"
        "    TYPE = 'plain'\n"
    )
    info = tmp_path / "our_lenses-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: our-lenses\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[unisim_blender.lenses]\nbroken = our_lenses:Nothing\nplain = our_lenses:Plain\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    LENSES.forget_plugins()
    try:
        with pytest.warns(UserWarning, match="the lens 'broken' of our-lenses is left out: AttributeError"):
            lens = lens_from_dict({"type": "plain"})
        with pytest.raises(LensError, match="mei, plain, not 'other'"):
            lens_from_dict({"type": "other"})
    finally:
        LENSES.forget_plugins()
    assert lens.TYPE == "plain" and lens.to_dict() == {"type": "plain"}


def test_a_lens_of_the_same_numbers_is_made_once() -> None:
    """Its valid domain is searched for, and a window that is drawn asks for it every time."""
    document = {"type": "opencv_pinhole", "k1": -0.3, "k2": 0.1, "p1": 0.001}
    lens = lens_from_dict(document)
    assert lens_from_dict(dict(document)) is lens and lens.to_dict()["k1"] == -0.3
    assert lens_from_dict({**document, "k1": -0.31}) is not lens
    with pytest.raises(LensError):
        lens_from_dict({**document, "k1": {1, 2}})


def test_lenses_are_registered_under_their_names() -> None:
    assert {name: kind.TYPE for name, kind in LENSES.items()} == {name: name for name in LENSES}


PINHOLES = [
    OpenCVPinhole(),
    OpenCVPinhole(k1=-0.3, k2=0.1, p1=0.001, p2=-0.002, k3=-0.02),
    OpenCVPinhole(
        k1=0.3, k2=0.1, k3=0.02, k4=0.5, k5=0.1, k6=0.02, p1=0.01, p2=0.01, s1=0.01, s2=-0.01, s3=0.005, s4=0.001
    ),
]


@pytest.mark.parametrize("lens", PINHOLES)
def test_opencvs_pinhole_projects_to_the_same_points(lens: OpenCVPinhole) -> None:
    cv2 = pytest.importorskip("cv2")
    points = directions(lens, 500, 3, 0.99)
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
    k = np.array([[900.0, 0, 400], [0, 800, 300], [0, 0, 1]])
    wanted = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k, np.array([getattr(lens, name) for name in names]))[
        0
    ][:, 0]
    u, v, valid = CameraModel(800, 600, 900.0, 800.0, 400.0, 300.0, lens=lens).project(points)
    assert valid.all()
    assert np.allclose(np.stack([u, v], -1), wanted, rtol=1e-11, atol=1e-8)


@pytest.mark.parametrize(
    "lens", [OpenCVFisheye(), OpenCVFisheye(k1=-0.02, k2=0.003, k3=-0.001), OpenCVFisheye(k1=0.1, k4=-0.001)]
)
def test_opencvs_fisheye_projects_to_the_same_points(lens: OpenCVFisheye) -> None:
    cv2 = pytest.importorskip("cv2")
    points = directions(lens, 500, 3, 0.99)
    points = points[points[:, 2] > 0.05]  # OpenCV's own code stops at a right angle
    k = np.array([[300.0, 0, 400], [0, 310, 300], [0, 0, 1]])
    coefficients = np.array([lens.k1, lens.k2, lens.k3, lens.k4])
    wanted = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), k, coefficients)[0][:, 0]
    u, v, valid = CameraModel(800, 600, 300.0, 310.0, 400.0, 300.0, lens=lens).project(points)
    assert valid.all() and len(points) > 100
    assert np.allclose(np.stack([u, v], -1), wanted, rtol=1e-11, atol=1e-8)


def test_mei_without_distortion_is_the_formula() -> None:
    """KITTI-360's: x / (z + xi) on the unit sphere. At xi 0 that is a pinhole, at 1 stereographic: 2 m = 2 tan(angle / 2)."""
    rays = directions(Mei(1.0), 300, 5, 0.9)
    plane, _ = Mei(1.0).project(rays)
    half = np.tan(np.arccos(rays[:, 2]) / 2)
    assert np.allclose(np.hypot(*plane.T), half, atol=1e-12)
    ahead = rays[rays[:, 2] > 0.2]
    assert np.allclose(Mei(0.0).project(ahead)[0], ahead[:, :2] / ahead[:, 2:], atol=1e-12)


def test_f_theta_takes_polynomials_in_pixels() -> None:
    """The forward and the backward polynomial of the same lens, r = 600 a and a = r / 600, give the same."""
    focal, forward = FTheta.from_pixels([0.0, 600.0, 0.0, -20.0], True, math.radians(100))
    assert focal == 600.0 and math.degrees(forward.max_angle_rad) == pytest.approx(100)
    rays = directions(forward, 100, 1)
    plane, _ = forward.project(rays)
    angle = np.arccos(rays[:, 2])
    assert np.allclose(np.hypot(*plane.T) * focal, 600 * angle - 20 * angle**3, atol=1e-9)
    focal, backward = FTheta.from_pixels([0.0, 1 / 600, 0.0, 1e-9], False, math.radians(100))
    radius = np.hypot(*backward.project(rays)[0].T) * focal
    assert np.allclose(radius / 600 + 1e-9 * radius**3, angle, atol=1e-9)
    with pytest.raises(LensError, match="must begin with 0"):
        FTheta.from_pixels([0.1, 600.0], True, 1.0)


@pytest.mark.parametrize(
    ("lens", "degrees"),
    [
        (
            OpenCVPinhole(k1=-0.3),
            math.degrees(math.atan(math.sqrt(0.999 / 0.9))),
        ),  # r + k1 r3 turns where 1 + 3 k1 r2 = 0
        (OpenCVFisheye(max_angle_deg=97.0), 97.0),
        (OpenCVFisheye(), 180.0),
        (Mei(2.0), math.degrees(math.acos(-0.5 + 0.0015))),
    ],
)
def test_the_stated_domain(lens: Lens, degrees: float) -> None:
    assert math.degrees(lens.max_angle_rad) == pytest.approx(degrees, abs=0.05)


def test_points_behind_the_camera_are_seen_by_a_wide_lens() -> None:
    model = CameraModel(1000, 1000, 200.0, 200.0, 500.0, 500.0, lens=OpenCVFisheye())
    u, v, valid = model.project(np.array([[1.0, 0.0, -0.5], [0.0, 0.0, -1.0]]))
    assert valid.tolist() == [True, False]
    assert u[0] == pytest.approx(500 + 200 * (np.pi / 2 + np.arctan(0.5))) and v[0] == pytest.approx(500)
