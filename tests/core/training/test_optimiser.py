"""Adam without torch's compiler: torch's steps to the bit, and a training that does not import what it does not need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from small_log import write_small_log

from unisim_blender.core import native
from unisim_blender.core.ops.devices import torch_threads
from unisim_blender.core.ops.mlp import two_layers_compiled, two_layers_reference
from unisim_blender.core.training.setup import Adam, CompiledAdam


def steps(kind: type[torch.optim.Adam], fused: bool) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    first, second = (torch.nn.Parameter(torch.randn(n, generator=generator)) for n in (1000, 7))
    groups = [{"params": [first], "lr": 0.1, "eps": 1e-15}, {"params": [second], "lr": 0.02}]
    optimiser = kind(groups, lr=1e-3, betas=(0.9, 0.99), fused=fused)
    for step in range(6):
        optimiser.zero_grad(set_to_none=False)
        ((first.square().sum() + second.sin().sum()) * (step + 1)).backward()
        optimiser.step()
        if step == 3:
            optimiser.load_state_dict(optimiser.state_dict())
    assert first.requires_grad and torch.is_grad_enabled()
    return torch.cat([first.detach(), second.detach()])


@pytest.mark.parametrize("fused", [True, False])
def test_steps_are_torchs_to_the_bit(fused: bool) -> None:
    before = steps(Adam, fused)
    assert torch.equal(before, steps(torch.optim.Adam, fused)) and torch.equal(before, steps(Adam, fused))


STEP = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from small_training import SMALL
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.training.trainer import Trainer
trainer = Trainer(open_log(Path(sys.argv[2])), SMALL)
trainer.step()
assert trainer.optimiser.state_dict()["state"]
print("torch._dynamo" in sys.modules)
"""


def test_a_step_does_not_import_torchs_compiler(tmp_path: Path) -> None:
    write_small_log(tmp_path / "log")
    command = [sys.executable, "-c", STEP, str(Path(__file__).parents[2] / "support"), str(tmp_path / "log")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.skipif(native.library() is None, reason="needs the compiled kernels")
def test_compiled_steps_are_torchs_and_leave_gradients_of_zero() -> None:
    generator = torch.Generator().manual_seed(0)
    values = [torch.randn(n, generator=generator) for n in (150_003, 7)]
    gradients = [[torch.randn(v.shape, generator=generator) * 10.0 ** -(4 * k) for v in values] for k in range(6)]
    results = []
    for kind, threads in ((CompiledAdam, 1), (CompiledAdam, 2), (torch.optim.Adam, 1)):
        parameters = [torch.nn.Parameter(v.clone()) for v in values]
        groups = [{"params": parameters[:1], "lr": 0.1, "eps": 1e-15}, {"params": parameters[1:], "lr": 0.02}]
        optimiser = kind(groups, lr=1e-3, betas=(0.9, 0.99), fused=True)
        for number, step in enumerate(gradients):
            for parameter, gradient in zip(parameters, step, strict=True):
                parameter.grad = gradient.clone()
                parameter.grad[64:128] = 0.0 if number < 4 else 1e-12
            with torch_threads(threads):
                optimiser.step()
            assert kind is torch.optim.Adam or not any(bool(p.grad.any()) for p in parameters if p.grad is not None)
            if number == 3:
                optimiser.load_state_dict(optimiser.state_dict())
        states = [optimiser.state[p] for p in parameters]
        results.append([*parameters, *(s[name] for s in states for name in ("exp_avg", "exp_avg_sq", "step"))])
    assert all(torch.equal(a, b) for a, b in zip(*results[:2], strict=True))
    for a, b in zip(results[0], results[2], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6 * float(b.abs().max()))


@pytest.mark.skipif(native.library() is None, reason="needs the compiled kernels")
def test_points_of_zero_gradient_have_none_and_change_no_sum() -> None:
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(300, 9, generator=generator)
    weights = [torch.randn(*shape, generator=generator) for shape in ((20, 9), (5, 20), (5,))]
    of_output = torch.randn(300, 5, generator=generator) * (torch.rand(300, 1, generator=generator) < 0.6)
    of_output[128:256] = 0.0
    results = []
    for layers in (two_layers_compiled, two_layers_reference):
        inputs = [v.clone().requires_grad_() for v in (x, *weights)]
        layers(*inputs).backward(of_output)
        results.append([v.grad for v in inputs])
    for a, b in zip(*results, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)
