"""nuScenes' layout: its folders of tables, and what names a scene."""

from __future__ import annotations

from pathlib import Path

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
