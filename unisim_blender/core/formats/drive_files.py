"""What of a log's files tells its drive: of a log at a URL, the others are not fetched for a trained scene, which needs neither
recorded images nor sweeps."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ..remote.copies import FolderPart
from .readers import all_readers


def drive_files(sizes: Mapping[str, int]) -> Collection[str]:
    """Return the names of the files of a log's folder that are read when it is opened, given all files' sizes in bytes; all of
    them where its reader does not say, by a method `drive_files` of its own with the same argument."""
    for reader in all_readers():
        chosen = getattr(reader, "drive_files", None)
        found: Collection[str] | None = None if chosen is None else chosen(sizes)
        if found is not None:
            return found
    return sizes


DRIVE = FolderPart("drive", drive_files)
"""The part of a log that its drive is made of."""
