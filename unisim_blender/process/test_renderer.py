"""Test of the renderer, whose report the preferences show."""

import threading

import bpy

from ..bridge.window.areas import areas
from ..preferences import interpreter
from ..translations import message
from . import interpreters

POLL_S = 0.2


def report_of(chosen: str) -> str:
    """Lines on what was found, and on what was tried before it."""
    found, failed = interpreters.find(chosen)
    lines = [f"{one.path}: {one.problem}" for one in failed]
    if found is None:
        return "\n".join([*lines, interpreters.HOW_TO_MEND])
    about = found.about
    torch = f", torch {about['torch']}" if about["torch"] else ""
    memory = f", {about['memory_bytes'] / 2**30:.0f} GiB" if about["memory_bytes"] else ""
    return "\n".join(
        [
            message("Renders with {path}", path=found.path),
            message(
                "Python {version}, kernels: {kernels}", version=f"{about['python']}{torch}", kernels=about["kernels"]
            ),
            f"{', '.join(about['devices'])}{memory}",
            *(
                [
                    message(
                        "Rendering runs on the CPU; training and GPU rendering need an interpreter with torch, named above"
                    )
                ]
                if about["training_lacks"]
                else []
            ),
            *lines,
        ]
    )


class UNISIM_OT_test_renderer(bpy.types.Operator):
    """Find an interpreter that can render and show its capabilities"""

    bl_idname = "unisim.test_renderer"
    bl_label = "Test Renderer"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask in a thread; without a window, wait."""
        chosen, answer = interpreter(), []
        thread = threading.Thread(target=lambda: answer.append(report_of(chosen)), daemon=True)
        thread.start()
        context.window_manager.unisim_renderer = message("Searching…")

        def tell() -> float | None:
            if thread.is_alive():
                return POLL_S
            bpy.context.window_manager.unisim_renderer = answer[0] if answer else message("The test failed")
            for area in areas():
                area.tag_redraw()
            return None

        if bpy.app.background:
            thread.join()
            tell()
        else:
            bpy.app.timers.register(tell, first_interval=POLL_S, persistent=True)
        return {"FINISHED"}


CLASSES = (UNISIM_OT_test_renderer,)
