"""Compile the kernels for NVIDIA GPUs into one file, and say what registers and memory they take.

python tools/compile_cuda.py FILE

The interpreter has the packages nvidia-cuda-nvcc and nvidia-cuda-cccl, or nvcc is on the path.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "native" / "cuda" / "kernels.cu"
CAPABILITIES = (80, 86, 89, 90, 120)
"""Compute capabilities with machine code of their own; later ones compile the oldest's PTX when it is loaded."""


REGISTERS, THREADS = 65536, 2048
"""Registers and threads of a multiprocessor."""
BLOCK = 128
"""Threads of a block, as in core/cuda_driver.py."""


class KernelUse(NamedTuple):
    """What a kernel takes on GPUs of a capability: registers of a thread, bytes of its stack, and bytes of registers
    that it spills, itself and in the functions that it calls, of which a ray's march is one."""

    kernel: str
    capability: str
    registers: int
    stack: int
    spilled: int
    spilled_by_functions: int

    @property
    def occupancy(self) -> float:
        """The part of a multiprocessor's threads that run at the same time; registers are given to warps by 256."""
        of_warp = -(-self.registers * 32 // 256) * 256
        blocks = REGISTERS // (of_warp * (BLOCK // 32))
        return min(blocks * BLOCK, THREADS) / THREADS


def compiler() -> str:
    """Return the path of CUDA's compiler. Raises SystemExit where there is none."""
    own = sorted((ROOT / ".venv-cuda").glob("lib/python*/site-packages"))  # of `make cuda`
    packages = (Path(folder) / "nvidia" for folder in [*sys.path, *map(str, own)])
    of_packages = (path for folder in packages for path in sorted(folder.glob("cu*/bin/nvcc"), reverse=True))
    if nvcc := next(map(str, of_packages), None) or shutil.which("nvcc"):
        return nvcc
    raise SystemExit("Error: CUDA's compiler is missing: pip install nvidia-cuda-nvcc nvidia-cuda-cccl")


def compiled(target: Path, capabilities: Sequence[int] = CAPABILITIES) -> list[KernelUse]:
    """Compile the kernels into a file, and return what they take. Raises SystemExit with what the compiler says."""
    codes = [f"-gencode=arch=compute_{n},code=sm_{n}" for n in capabilities]
    oldest = capabilities[0]
    codes.append(f"-gencode=arch=compute_{oldest},code=compute_{oldest}")
    flags = ["-std=c++17", "-O3", "--expt-relaxed-constexpr", "-Xptxas", "-v", "-fatbin", "-t", "0"]
    ended = subprocess.run(
        [compiler(), *flags, *codes, "-o", str(target), str(SOURCE)], stderr=subprocess.PIPE, text=True, check=False
    )
    if ended.returncode:
        raise SystemExit(ended.stderr)
    uses = []
    for part in ended.stderr.split("Compiling entry function")[1:]:
        kernel, capability = re.findall(r"'(\w+)'", part)[:2]
        spilled, *by_functions = (int(n) for n in re.findall(r"(\d+) bytes spill stores", part))
        registers, stack = (re.findall(what, part) for what in (r"Used (\d+) registers", r"(\d+) bytes stack frame"))
        uses.append(KernelUse(kernel, capability, int(registers[0]), int(stack[0]), spilled, sum(by_functions)))
    return uses


def main(target: Path) -> None:
    """Compile, and print a line for each kernel and capability."""
    for use in compiled(target):
        print(
            f"{use.kernel} {use.capability}: {use.registers} registers, occupancy {use.occupancy:.0%}, {use.stack} bytes of "
            f"stack, {use.spilled} bytes spilled, {use.spilled_by_functions} by what it calls"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]))
