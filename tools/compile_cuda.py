"""Compile the kernels for NVIDIA GPUs into one file, and say what registers and memory they take.

python tools/compile_cuda.py FILE

The interpreter has the packages nvidia-cuda-nvcc and nvidia-cuda-cccl, or nvcc is on the path.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "native" / "cuda" / "kernels.cu"
CAPABILITIES = (80, 86, 89, 90, 120)
"""Compute capabilities with machine code of their own; later ones compile the oldest's PTX when it is loaded."""


def compiler() -> str:
    """Return the path of CUDA's compiler. Raises SystemExit where there is none."""
    packages = (Path(folder) / "nvidia" for folder in sys.path)
    of_packages = (path for folder in packages for path in sorted(folder.glob("cu*/bin/nvcc"), reverse=True))
    if nvcc := next(map(str, of_packages), None) or shutil.which("nvcc"):
        return nvcc
    raise SystemExit("Error: CUDA's compiler is missing: pip install nvidia-cuda-nvcc nvidia-cuda-cccl")


def main(target: Path) -> int:
    """Compile and print a line for each capability; return the compiler's exit status."""
    codes = [f"-gencode=arch=compute_{n},code=sm_{n}" for n in CAPABILITIES]
    oldest = CAPABILITIES[0]
    codes.append(f"-gencode=arch=compute_{oldest},code=compute_{oldest}")
    flags = ["-std=c++17", "-O3", "--expt-relaxed-constexpr", "-Xptxas", "-v", "-fatbin"]
    ended = subprocess.run(
        [compiler(), *flags, *codes, "-o", str(target), str(SOURCE)], stderr=subprocess.PIPE, text=True, check=False
    )
    if ended.returncode:
        print(ended.stderr, file=sys.stderr)
        return ended.returncode
    for part in ended.stderr.split("Compiling entry function")[1:]:
        kernel, capability = re.findall(r"'(\w+)'", part)[:2]
        spills = sum(int(n) for n in re.findall(r"(\d+) bytes spill stores", part))
        registers, stack = (
            re.search(rf"{what}", part) for what in (r"Used (\d+) registers", r"(\d+) bytes cumulative")
        )
        assert registers and stack
        print(f"{kernel} {capability}: {registers[1]} registers, {stack[1]} bytes of stack, {spills} bytes spilled")
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    raise SystemExit(main(Path(sys.argv[1])))
