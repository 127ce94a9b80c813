"""Runs changed files through readers, in a process of its own with bounded memory: a crash is a failure, and is seen as one.

python tests/core/mutations/run.py --count 100000 [--reader NAME] [--seed 0] [--out FILE]
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from pathlib import Path
from types import FrameType
from typing import Any

LIMIT_S = 5.0
"""An input may take so much of a processor."""
MEMORY_BYTES = 1 << 30
"""So much more memory than before its inputs a process may take."""
MOST_LETTERS = 1000
"""Of a sentence, beside the path in it."""
SHOWN = 40
"""So many failures a reader are kept."""


class TooLongError(Exception):
    """An input was not done within LIMIT_S."""


def _ring(signum: int, frame: FrameType | None) -> None:
    raise TooLongError(f"took more than {LIMIT_S:g} s of a processor")


def fault_of(names: tuple[str, ...], read: Any) -> str:
    """What is wrong with how ``read`` ends; "" where it reads or refuses as it should."""
    from unisim_blender.core.errors import UnisimError

    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        read()
    except UnisimError as error:
        text = str(error)
        if "\n" in text:
            return f"more than a line: {text[:200]!r}"
        if len(text) > MOST_LETTERS:
            return f"{len(text)} letters: {text[:200]!r}"
        if not any(name in text for name in names):
            return f"names no file: {text[:200]!r}"
    except BaseException as error:  # noqa: BLE001 whatever a reader raises beside is a failure
        last = traceback.extract_tb(error.__traceback__)
        ours = next((at for at in reversed(last) if "unisim_blender" in at.filename), last[-1])
        return f"{type(error).__name__} at {Path(ours.filename).name}:{ours.lineno}: {str(error)[:200]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return ""


def run_reader(name: str, count: int, seed: int, folder: Path) -> dict[str, Any]:
    """Figures of ``count`` inputs of a reader, and its failures by what they are, with the first number of each."""
    import numpy as np

    from mutations.readers import READERS

    reader = READERS[name](folder)
    begun_all = time.process_time()
    failures: dict[str, list[int]] = {}
    slowest, slow_input = 0.0, 0
    for number in range(count):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
        reader.change(rng)
        begun = time.process_time()
        fault = fault_of(reader.names, reader.read)
        seconds = time.process_time() - begun
        if seconds > slowest:
            slowest, slow_input = seconds, number
        if fault:
            known = failures.setdefault(fault.split(": ")[0] if " at " in fault else fault[:40], [])
            known.append(number)
            if len(known) == 1 and len(failures) <= SHOWN:
                print(f"{name} {number}: {fault}", flush=True)
    return {
        "inputs": count,
        "failures": {fault: [len(n), n[0]] for fault, n in failures.items()},
        "seconds": round(time.process_time() - begun_all, 1),
        "slowest_s": round(slowest, 3),
        "slowest_input": slow_input,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }


def main() -> int:
    """All readers' figures as JSON on the last line; exit 1 where there are failures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=100, help="inputs of all readers together")
    parser.add_argument("--reader", action="append")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--one", type=int, help="the number of one input, whose file is left in --out")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    faulthandler.enable()
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(Path(__file__).parents[1]))
    signal.signal(signal.SIGPROF, _ring)
    from mutations.readers import READERS

    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 0
    if pages:
        limit = pages * resource.getpagesize() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    names = options.reader or list(READERS)
    results = {}
    with tempfile.TemporaryDirectory() as scratch:
        os.environ["UNISIM_CACHE"] = f"{scratch}/cache"
        for name in names:
            folder = Path(scratch) / name.replace(" ", "-").replace(":", "")
            folder.mkdir()
            if options.one is not None:
                import numpy as np

                folder = options.out or folder
                folder.mkdir(exist_ok=True)
                reader = READERS[name](folder)
                reader.change(np.random.default_rng([options.seed, zlib.crc32(name.encode()), options.one]))
                reader.read()
                continue
            results[name] = run_reader(name, -(-options.count // len(names)), options.seed, folder)
            if options.out:
                options.out.write_text(json.dumps(results, indent=1))
    print(json.dumps(results))
    return int(any(result["failures"] for result in results.values()))


if __name__ == "__main__":
    sys.exit(main())
