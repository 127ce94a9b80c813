"""Entry point of the renderer's interpreter. It puts this package on the interpreter's path, and behind all that the
interpreter has the extension's wheels, where they are for its version of Python.

python bootstrap.py WHEELS probe              says in JSON what the interpreter has
python bootstrap.py WHEELS serve FOLDER       the worker: requests on stdin, events on stdout, pixels in files in FOLDER
python bootstrap.py WHEELS actors LOG         makes thumbnails of a log's actors, and writes a line of JSON for each
python bootstrap.py WHEELS lamps LOG SCENE    finds lamps in a log's images, in the world of a trained scene or "", into the cache
python bootstrap.py WHEELS pip ARGUMENTS      pip, which the extension brings
python bootstrap.py WHEELS cli ARGUMENTS      the command line `unisim`

WHEELS is Blender's folder of unpacked wheels, `.../pythonX.Y/site-packages`, or empty. Other folders of packages for the same
Python may follow, separated as in the variable PATH.
"""

import importlib.util
import json
import os
import runpy
import signal
import sys
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

BUNDLED = Path(__file__).resolve().parent / "bundled"
"""Plug-ins that the extension brings, with the metadata of their entry points; a source tree has no such folder."""
OWN = {"unisim_blender", *(path.name for path in BUNDLED.glob("*") if (path / "__init__.py").is_file())}


class Here:
    """Finds modules of the package and of its plug-ins in their own folders, also where other copies are installed."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> "ModuleSpec | None":
        """As importlib asks for it."""
        if name.partition(".")[0] not in OWN:
            return None
        return PathFinder.find_spec(name, [str(BUNDLED)] if path is None else path)  # type: ignore[arg-type]


def load(root: Path) -> None:
    """The package in folder ``root`` under its own name, whatever it is called inside Blender."""
    sys.meta_path.insert(0, Here)
    spec = importlib.util.spec_from_file_location(
        "unisim_blender", root / "__init__.py", submodule_search_locations=[str(root)]
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["unisim_blender"] = module
    spec.loader.exec_module(module)


def main() -> None:
    """Do what the second argument says."""
    here = Path(__file__).resolve().parent
    sys.path[:] = [place for place in sys.path if Path(place).resolve() != here]
    places, what, *arguments = sys.argv[1:]
    wheels, *others = places.split(os.pathsep)
    if Path(wheels).parent.name == f"python{sys.version_info.major}.{sys.version_info.minor}":
        sys.path += [wheels, *others]
    if BUNDLED.is_dir():
        sys.path.insert(0, str(BUNDLED))  # where `importlib.metadata` looks for entry points
    load(here)
    from unisim_blender.core.errors import install_into
    from unisim_blender.core.processes import wait_briefly

    wait_briefly()
    if wheels in sys.path and others:
        install_into(others[0], has_window=True)
    if what == "probe":
        from unisim_blender.core.worker.about import about

        with os.fdopen(os.dup(1), "w") as answer:
            os.dup2(2, 1)  # what is imported may print
            print(json.dumps(about()), file=answer)
    elif what == "serve":
        events = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # whatever prints must not break the protocol
        from unisim_blender.core.worker.server import Server, all_jobs

        Server(sys.stdin.buffer, events, all_jobs(Path(arguments[0]))).run()
    elif what == "actors":
        from unisim_blender.core.actor_images.cache import tell
        from unisim_blender.core.formats.readers import open_log

        tell(open_log(Path(arguments[0])))
    elif what == "lamps":
        from unisim_blender.core.prepare.scenario import lamps_at
        from unisim_blender.core.scenes.scene import Scene

        log, scene = arguments
        said = partial(print, flush=True)
        lamps_at(Path(log), Scene(Path(scene)) if scene else None, lambda share: said(json.dumps({"share": share})))
    elif what == "pip":
        if wheels in sys.path:
            sys.path.insert(0, wheels)  # before an older one of the interpreter's own
        import pip

        if tuple(map(int, pip.__version__.split(".")[:2])) < (24, 1):
            arguments = ["off" if argument == "raw" else argument for argument in arguments]
        sys.argv[1:] = arguments
        runpy.run_module("pip", run_name="__main__", alter_sys=True)
    else:
        sys.argv[1:] = arguments
        # Cancel interrupts; a Blender that a shell has started in the background leaves interrupts ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from unisim_blender.core.cli.main import main as cli

        cli()


if __name__ == "__main__":
    main()
elif (
    __name__ == "__mp_main__"
):  # in a process that renders frames beside others; it has the path of the one that started it
    load(Path(__file__).resolve().parent)
