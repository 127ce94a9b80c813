"""The Gymnasium environment: spaces, seeds, ends, the checks of Gymnasium and stable-baselines3, a short training."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from written_street import write_street

gymnasium = pytest.importorskip("gymnasium", reason="the extra gym is not installed")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv  # noqa: E402

from unisim_blender.core.errors import SimulationError  # noqa: E402
from unisim_blender.core.simulation.environment import UniSimEnv  # noqa: E402
from unisim_blender.core.world.polyline import Polyline  # noqa: E402

FRAMES = 8
SIMULATION = {"actors": {"*": {"type": "auto"}}, "jitter": {"ego_aside_m": 0.4, "ego_speed_m_s": 0.5}}


@pytest.fixture(scope="module")
def options(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    log = write_street(tmp_path_factory.mktemp("environment") / "street", FRAMES, columns=300)
    return {"scenario": str(log), "renderer": "surfel", "quality": "fast", "width": 32, "simulation": SIMULATION}


@pytest.fixture(scope="module")
def env(options: dict[str, Any]) -> UniSimEnv:
    return UniSimEnv(**options, render_mode="rgb_array")


def test_gymnasium_accepts_it(env: UniSimEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


def test_gymnasium_knows_it_by_itself(options: dict[str, Any], tmp_path: Path) -> None:
    """Where a program imports Gymnasium alone; and Python starts without either, and without numpy and torch."""
    program = f"""
import sys
assert not {{"gymnasium", "numpy", "torch", "typing", "importlib.metadata"}} & sys.modules.keys(), sorted(sys.modules)
import gymnasium
assert gymnasium.envs.__spec__.loader is gymnasium.envs.__loader__ and "torch" not in sys.modules
assert "unisim_blender" not in sys.modules
assert "UniSim-v0" in gymnasium.envs.registry and gymnasium.spec("UniSim-v0").id == "UniSim-v0"
assert "CartPole-v1" in gymnasium.registry
vector = gymnasium.make_vec("UniSim-v0", 1, vectorization_mode="sync", **{options!r})
assert vector.single_action_space.shape == (2,)
"""
    result = subprocess.run([sys.executable, "-I", "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_an_episode(env: UniSimEnv) -> None:
    seen, info = env.reset(seed=5)
    assert seen["camera/front_camera"].shape == (18, 32, 3) and seen["camera/front_camera"].std() > 5
    grid = seen["lidar/pandar64"]
    back = np.abs(grid).sum(-1) > 0
    assert back.mean() > 0.3 and info["points"]["pandar64"].points.shape == (back.sum(), 5)
    np.testing.assert_array_equal(grid[back], info["points"]["pandar64"].points)
    assert (np.diff(seen["route"][:, 0]) > 0).all() and np.abs(seen["route"][:, 1]).max() < 3
    shown = env.render()
    assert shown is not None and np.array_equal(shown, seen["camera/front_camera"])
    total, ended = 0.0, False
    while not ended:
        seen, reward, terminated, truncated, info = env.step(np.array([0.0, 0.0], np.float32))
        total, ended = total + reward, terminated or truncated
        assert info["ended"] == ("time_over" if ended else "")
    assert truncated and not terminated and info["time_us"] == 700_000 and info["collided_with"] == ()
    assert 2 < total < 8, "metres of progress"


@pytest.mark.parametrize("size", [True, (16, 90), (1, 7)])
def test_range_images(env: UniSimEnv, options: dict[str, Any], size: bool | tuple[int, int]) -> None:
    """Each cell has the nearest of the points that fall in it, as the observation of points has them."""
    model = env._lidars["pandar64"].model
    rows, columns = (model.beams, model.columns) if size is True else size  # type: ignore[misc]
    ranging = UniSimEnv(**options, range_image=size)
    space = ranging.observation_space["lidar/pandar64"]  # type: ignore[index]
    assert space.shape == (rows, columns, 2) and space.low.max() == 0 and space.high[0, 0].tolist() == [1000, 1]
    points = env.reset(seed=5)[0]["lidar/pandar64"].astype(np.float64)
    seen = ranging.reset(seed=5)[0]["lidar/pandar64"]
    assert space.contains(seen)
    expected = np.zeros((rows, columns, 2))
    for beam in range(model.beams):
        for column in np.flatnonzero(points[beam].any(-1)):
            far = np.hypot(np.hypot(points[beam, column, 0], points[beam, column, 1]), points[beam, column, 2])
            cell = expected[beam * rows // model.beams, column * columns // model.columns]
            if cell[0] == 0 or far < cell[0]:
                cell[:] = far, points[beam, column, 3]
    np.testing.assert_allclose(seen, expected, atol=1e-4)
    assert (seen[..., 0] > 0).mean() > 0.3 and 0 < seen[..., 1].max() <= 1


@pytest.mark.parametrize("size", [(0, 90), (10_000, 90), (16.0, 90.0), (16,), "full"])
def test_range_images_of_no_size(options: dict[str, Any], size: Any) -> None:
    with pytest.raises(
        SimulationError, match=r"range_image: must be True, or rows and columns up to the \d+ and \d+ of pandar64"
    ):
        UniSimEnv(**options, range_image=size)


def test_it_says_why_an_episode_ended(env: UniSimEnv, options: dict[str, Any], tmp_path: Path) -> None:
    still = np.zeros(2, np.float32)
    env.reset(seed=5)
    assert env.step(still)[4]["ended"] == ""
    env._route = Polyline(env._route.points + 50.0, env._route.along_m)
    _, _, terminated, truncated, info = env.step(still)
    assert terminated and not truncated and info["ended"] == "off_route" and info["collided_with"] == ()
    parked = {"type": "move", "actor": "car-06", "pose": {"position": [7.5, 0.0, 0.8], "yaw_deg": 0.0}}
    document = {"format": "unisim-scenario", "version": 1, "name": "met", "log": options["scenario"], "edits": [parked]}
    (tmp_path / "met.json").write_text(json.dumps(document))
    meets = UniSimEnv(
        **{**options, "scenario": str(tmp_path / "met.json"), "simulation": None}, sensors=("front_camera",)
    )
    meets.reset(seed=0)
    for _ in range(5):
        _, reward, terminated, truncated, info = meets.step(still)
        if terminated:
            break
    assert terminated and not truncated and reward < -90
    assert info["ended"] == "collision" and info["collided_with"] == ("car-06",)


@pytest.mark.parametrize("action", [[0.0], np.zeros((2, 1)), "left", [None, 1.0], [True, False]])
def test_actions_that_are_none(env: UniSimEnv, action: Any) -> None:
    env.reset(seed=5)
    with pytest.raises(SimulationError, match="action: must be two numbers from -1 to 1, not"):
        env.step(action)
    with pytest.raises(SimulationError, match="must be a finite number, not nan"):
        env.step(np.array([np.nan, 0.0]))


def test_seeds_decide_where_an_episode_starts(env: UniSimEnv) -> None:
    one, _ = env.reset(seed=1)
    other, _ = env.reset(seed=2)
    same, _ = env.reset(seed=1)
    assert all(np.array_equal(one[name], same[name]) for name in one)
    assert not np.array_equal(one["route"], other["route"])


def test_braking_costs_progress(env: UniSimEnv) -> None:
    rewards = []
    for acceleration in (0.0, -0.9):
        env.reset(seed=3)
        rewards.append(sum(env.step(np.array([acceleration, 0.0], np.float32))[1] for _ in range(4)))
    assert rewards[1] < rewards[0] - 0.2


@pytest.mark.slow
def test_vector_environments(options: dict[str, Any]) -> None:

    def make() -> Any:
        return gymnasium.make("UniSim-v0", **options, disable_env_checker=True)

    found = []
    for kind in (SyncVectorEnv, AsyncVectorEnv):
        vector = kind([make, make])
        first, _ = vector.reset(seed=[1, 2])
        after = vector.step(np.zeros((2, 2), np.float32))[0]
        found.append((first, after))
        vector.close()
    for sync, asynchronous in zip(*found, strict=True):
        assert all(np.array_equal(sync[name], asynchronous[name]) for name in sync)


@pytest.mark.slow
def test_stable_baselines_trains_on_it(options: dict[str, Any]) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    from stable_baselines3.common.env_checker import check_env as check_by_sb3

    env = UniSimEnv(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_by_sb3(env)
    seeing = UniSimEnv(**{**options, "width": 72}, sensors=("front_camera",))
    model = sb3.PPO("MultiInputPolicy", seeing, n_steps=8, batch_size=8, n_epochs=1, seed=0)
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    model.learn(8)
    assert any(not value.equal(before[name]) for name, value in model.policy.state_dict().items())


def test_refused(tmp_path: Path) -> None:
    from unisim_blender.core.errors import UnisimError

    with pytest.raises(UnisimError, match="nothing"):
        UniSimEnv(tmp_path / "nothing.json")
