"""``python -m unisim_street.cycles ORDER``: draws what a street still lacks, and tells on its standard
output how far it is.

ORDER is a JSON document, `path_tracer.Order`'s. A line of JSON tells each step: {"total": images}, {"done": image},
{"error": sentence}. The process ends when its input is closed, so it never outlives the command that started it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from typing import Any, NoReturn

from unisim_blender.core.errors import UnisimError

from ..drawing.path_tracer import Order


def main() -> NoReturn:
    """Draw, with standard output kept for the lines of JSON: Blender prints to the other descriptor."""
    lines = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def say(**event: Any) -> None:
        lines.write(json.dumps(event) + "\n")

    threading.Thread(target=_end_with_input, daemon=True).start()
    code = 0
    try:
        from .draw import draw

        draw(Order.from_text(sys.argv[1]), say)
    except UnisimError as error:
        say(error=str(error))
        code = 1
    # at once, and with the lines still open: when they close, so does the input, which would be taken for a
    # parent's # end
    os._exit(code)


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    main()
