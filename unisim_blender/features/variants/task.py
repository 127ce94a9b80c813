"""Variants rendered one after the other, each into a folder of its own, as one task in the background."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...core.sequence.records import finished_moments
from ...core.world.captures import CaptureKey
from ...process.tasks import SequenceTask
from ...translations import message


@dataclass(frozen=True)
class VariantRun:
    """One variant: its name, the command's arguments, its folder, and the frames that it has."""

    name: str
    arguments: list[str]
    folder: Path
    wanted: set[CaptureKey]

    @property
    def done(self) -> int:
        """Frames that are finished."""
        return finished_moments(self.folder, self.wanted)


class VariantsTask(SequenceTask):
    """The sequences of several variants. Cancelled and started again, it goes on with the frames that are missing."""

    def __init__(self, parts: list[VariantRun], folder: Path, chosen: str) -> None:
        super().__init__([], folder, float(sum(len(part.wanted) for part in parts)), chosen)
        self.parts = parts
        self.at = 0
        """The variant that is being rendered."""

    @property
    def done(self) -> float:
        """Finished frames of all variants."""
        return float(sum(part.done for part in self.parts))

    @property
    def problem(self) -> str:
        """Why it failed, and at which variant; "" where it did not."""
        found = super().problem
        return f"{self.parts[self.at].name}: {found}" if found else ""

    def measure(self) -> str:
        """Which variant it is at, and frames of how many."""
        part = self.parts[self.at]
        whole = message("{done} of {total} frames", done=int(self.done), total=int(self.total))
        if not self.running and not self.cancelled:
            return message("{frames} of {count} variants", frames=whole, count=len(self.parts))
        return message(
            "{name} ({number} of {count}): {done} of {total}; {frames} in all",
            name=part.name, number=self.at + 1, count=len(self.parts), done=part.done, total=len(part.wanted),
            frames=whole,
        )  # fmt: skip

    def newest(self) -> Path | None:
        """The image that was finished last."""
        self_folder = self.folder
        try:
            self.folder = self.parts[self.at].folder
            return super().newest()
        finally:
            self.folder = self_folder

    def _run(self) -> None:
        code = 0
        for at, part in enumerate(self.parts):
            self.at = at
            code = self._call(part.arguments)
            if code or self.cancelled:
                break
        self.code = code
