"""Drivers of AlpaSim's protocol, over gRPC: the package's own ones on a small street, what they are sent, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from self_signed import certificate
from written_street import write_street

grpc = pytest.importorskip("grpc")
pytest.importorskip("carla_driver_interface")
from carla_driver_interface import protocol  # noqa: E402
from carla_driver_interface.driver import BaseDriver, DriveContext, DriveResult, SessionState  # noqa: E402
from carla_driver_interface.geometry import Pose, Trajectory  # noqa: E402
from carla_driver_interface.policies import ConstantSpeedPolicy, RouteFollowerPolicy  # noqa: E402
from carla_driver_interface.server import serving  # noqa: E402
from carla_driver_interface.service import EgodriverServicer  # noqa: E402

from unisim_blender.core.cli.main import run  # noqa: E402
from unisim_blender.core.formats.readers import open_log  # noqa: E402
from unisim_blender.core.simulation.rollout.steps import read_steps  # noqa: E402
from unisim_blender.core.simulation.vehicle.actions import Control, Plan  # noqa: E402

SURFELS = ("--renderer", "surfel", "--quality", "fast")


class Noting(BaseDriver):
    """Plans to stand still, notes what it was given, and ends the session at its third drive."""

    name = "noting"

    def __init__(self) -> None:
        self.session: SessionState | None = None
        self.closed = 0
        self.seen: list[dict[str, object]] = []
        self.nonsense = False

    def on_session_start(self, session: SessionState) -> None:
        self.session, self.seen = session, []

    def on_session_close(self, session: SessionState) -> None:
        self.closed += 1

    def drive(self, ctx: DriveContext) -> DriveResult:
        frames = {name: ctx.session.latest_frame(name) for name in ctx.session.frame_history}
        route = np.array(ctx.session.route_waypoints_in_rig)
        pose = ctx.session.latest_pose()
        assert pose is not None
        self.seen.append({"frames": frames, "route": route, "pose": pose, "speed": ctx.session.speed_mps()})
        x = float("nan") if self.nonsense else 1.0
        plan = Trajectory([ctx.time_now_us + 500_000], [Pose.from_xyz_yaw(x, 0.0, 0.0, 0.0)])
        return DriveResult(plan, terminate_session=len(self.seen) == 3)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("egodriver") / "street", 5, columns=300)


@pytest.fixture(scope="module")
def noting() -> Iterator[tuple[Noting, str]]:
    driver = Noting()
    with serving(driver, port=0, host="127.0.0.1") as port:
        yield driver, f"127.0.0.1:{port}"


def drive(log: Path, out: Path, address: str, *more: str, code: int = 0) -> Path:
    asked = ["drive", str(log), "--driver", "egodriver", "--driver-address", address, "--out", str(out)]
    assert run([*asked, *SURFELS, *more]) == code
    return out


@pytest.mark.parametrize("policy", [RouteFollowerPolicy, ConstantSpeedPolicy])
def test_its_own_policies_drive_the_street(log: Path, tmp_path: Path, policy: type[BaseDriver]) -> None:
    """Both are asked for 12 m/s: the street was recorded at 8. The route follower stays on the recorded path."""
    with serving(policy(cruise_speed_mps=12.0), port=0, host="127.0.0.1") as port:  # type: ignore[call-arg]
        out = drive(log, tmp_path / "out", f"localhost:{port}", "--sensors", "front_camera", "--duration", "0.4")
    steps = read_steps(out)
    assert all(isinstance(step.action, Plan) for step in steps[1:])
    assert steps[-1].ego.speed_m_s > steps[0].ego.speed_m_s + 0.2
    recorded = open_log(log).drive.world_from_ego.positions[:, :2]
    off = min(np.hypot(*(recorded - [steps[-1].ego.x_m, steps[-1].ego.y_m]).T))
    assert off < 1.0
    assert json.loads((out / "scores.json").read_text())["driver"] == "egodriver"


def test_what_it_is_sent(log: Path, tmp_path: Path, noting: tuple[Noting, str]) -> None:
    driver, address = noting
    before = driver.closed
    out = drive(log, tmp_path / "out", address, "--seed", "5")
    assert driver.session is not None and driver.session.seed == 5 and driver.closed == before + 1
    steps, recorded = read_steps(out), open_log(log).drive
    # it ended its session: it was asked no more, and its vehicle brakes
    assert len(driver.seen) == 3 and steps[4].action == Control(-3.0, 0.0)
    camera = driver.session.cameras["front_camera"]
    pinhole = camera.intrinsics.opencv_pinhole_param
    model = recorded.cameras["front_camera"].model
    assert camera.intrinsics.resolution_w == model.width and pinhole.focal_length_x == pytest.approx(model.fx)
    # the street's ego frame lies on its ground: so does the rig
    assert camera.rig_to_camera.vec.z == pytest.approx(1.81, abs=0.05)
    seen = driver.seen[2]
    image = seen["frames"]["front_camera"]  # type: ignore[index]
    name = f"t{(image.frame_start_us + image.frame_end_us + 30_000) // 2:013d}us.png"
    assert np.array_equal(image.as_array(), np.asarray(Image.open(out / "camera" / "front_camera" / name)))
    sweep = seen["frames"]["pandar64"].as_array()  # type: ignore[index]
    assert len(sweep) > 1000
    assert abs(np.quantile(sweep[:, 2], 0.05)) < 0.05  # the ground below the rig
    route = np.asarray(seen["route"])
    # the street is straight but for a bend: the route begins at the vehicle and leads ahead
    assert np.hypot(*route[0, :2]) < 0.5 and route[20, 0] > 15 and abs(route[10, 1]) < 1
    assert seen["pose"].position[0] == pytest.approx(steps[2].ego.x_m, abs=1e-4)  # type: ignore[attr-defined]
    assert seen["speed"] == pytest.approx(steps[2].ego.speed_m_s, abs=1e-4)


@pytest.mark.parametrize(("start", "times"), [("0.2", [0, 100_000, 200_000]), ("0", [0])])
def test_its_history_before_the_start_is_the_recording(
    start: str, times: list[int], log: Path, tmp_path: Path, noting: tuple[Noting, str]
) -> None:
    driver, address = noting
    drive(log, tmp_path / "out", address, "--start", start, "--duration", "0.2", "--sensors", "front_camera")
    assert driver.session is not None
    sent, recorded = driver.session.ego_trajectory, open_log(log).drive.world_from_ego
    stamps = [int(time) for time in sent.timestamps_us]
    assert stamps[: len(times)] == times and len(driver.session.dynamic_states) == len(stamps)
    for time_us, pose in zip(times, sent.poses, strict=False):
        # the rig is at the rear axle: as far from the log's frame at every time
        apart = np.array(pose.position[:2]) - recorded.at(time_us / 1e6)[:2, 3]
        assert np.hypot(*(apart - (np.array(sent.poses[0].position[:2]) - recorded.at(times[0] / 1e6)[:2, 3]))) < 0.05


def test_a_start_that_is_drawn_has_no_history(log: Path, tmp_path: Path, noting: tuple[Noting, str]) -> None:
    driver, address = noting
    simulation = {"start_s": 0.2, "duration_s": 0.2, "jitter": {"ego_aside_m": 0.5}}
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": str(log), "simulation": simulation}
    (tmp_path / "s.json").write_text(json.dumps({**document, "edits": []}))
    drive(tmp_path / "s.json", tmp_path / "out", address, "--sensors", "front_camera")
    assert driver.session is not None
    assert int(driver.session.ego_trajectory.timestamps_us[0]) == 200_000


def test_another_machine_is_asked_through_tls(log: Path, tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    server = grpc.server(ThreadPoolExecutor(2))
    add: Any = protocol.add_EgodriverServiceServicer_to_server
    add(EgodriverServicer(ConstantSpeedPolicy()), server)
    pair = (key.read_bytes(), cert.read_bytes())
    port = server.add_secure_port("127.0.0.1:0", grpc.ssl_server_credentials([pair]))
    server.start()
    try:
        more = ("--sensors", "front_camera", "--duration", "0.2")
        out = drive(log, tmp_path / "out", f"127.0.0.1:{port}", "--driver-ca", str(cert), *more)
        drive(log, tmp_path / "plain", f"127.0.0.1:{port}", *more, code=1)
    finally:
        server.stop(0).wait()
    assert isinstance(read_steps(out)[1].action, Plan)


def test_refused(log: Path, tmp_path: Path, noting: tuple[Noting, str], capsys: pytest.CaptureFixture[str]) -> None:
    driver, address = noting
    wrong = [
        ("127.0.0.1:1", (), "--driver-address 127.0.0.1:1: start_session: UNAVAILABLE"),
        ("10.0.0.7:5000", (), "is another machine, which takes TLS"),
        ("nowhere", (), "--driver-address nowhere: must be HOST:PORT"),
        (address, ("--driver", "idm"), 'the driver "idm" has none'),
        (address, ("--driver-ca", str(tmp_path / "none.pem")), "none.pem: cannot be read"),
    ]
    for number, (where, more, sentence) in enumerate(wrong):
        drive(log, tmp_path / str(number), where, "--sensors", "front_camera", *more, code=1)
        assert sentence in capsys.readouterr().err
    assert run(["drive", str(log), "--driver", "egodriver", "--out", str(tmp_path / "x"), *SURFELS]) == 1
    assert "needs --driver-address" in capsys.readouterr().err
    driver.nonsense = True
    try:
        drive(log, tmp_path / "nonsense", address, "--sensors", "front_camera", code=1)
        assert "drive: trajectory.poses[1].pose.vec: must be finite" in capsys.readouterr().err
    finally:
        driver.nonsense = False
