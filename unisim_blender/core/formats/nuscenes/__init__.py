"""nuScenes v1.0: its folders of tables, what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log


class NuscenesReader:
    """Recognises and opens scenes of nuScenes."""

    name = "nuscenes"
    layout = "nuScenes: the dataset's folder with v1.0-*/sample_data.json, or of several scenes one's file in samples/"
    suffixes: tuple[str, ...] = (".bin",)

    def recognises(self, path: Path) -> bool:
        """Whether a folder has tables, or a file lies in samples/ or sweeps/ beside them."""
        return bool(find_tables(path)[1])

    def open(self, path: Path) -> Log:
        """Open the scene. Raises `LogError`."""
        from .read import NuscenesLog

        return NuscenesLog(path)


TABLE = "sample_data.json"
FILE_FOLDERS = ("samples", "sweeps")


def versions(root: Path) -> tuple[Path, ...]:
    """Return the folders of tables, v1.0-mini, in the dataset's folder."""
    return tuple(sorted(path.parent for path in root.glob(f"v1.0-*/{TABLE}")))


def find_tables(path: Path) -> tuple[Path, tuple[Path, ...], str]:
    """Return the dataset's folder, its folders of tables, and the file in it that stands for its scene ("" without one).

    The path is the dataset's folder, a folder of tables, or a file of samples/ or sweeps/; of another there are no folders of
    tables.
    """
    if path.is_dir():
        if path.name.startswith("v1.0-") and (path / TABLE).is_file():
            return path.parent, (path,), ""
        return path, versions(path), ""
    if len(path.parents) > 2 and path.parents[1].name in FILE_FOLDERS:
        root = path.parents[2]
        return root, versions(root), path.relative_to(root).as_posix()
    return path, (), ""
