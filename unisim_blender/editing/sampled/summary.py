"""What a recorded drive holds, as one line."""

from __future__ import annotations

from collections import Counter

from .source import Source


def summary(source: Source) -> str:
    """Return what a drive holds, as one line."""
    drive = source.drive
    labels = Counter(actor.label for actor in drive.actors.values())
    most = ", ".join(f"{count} {label}" for label, count in labels.most_common(3))
    others = f", {sum(labels.values()) - sum(n for _, n in labels.most_common(3))} others" if len(labels) > 3 else ""
    times = sorted(drive.time_s.values())
    parts = [
        f"{len(times)} frames ({times[-1] - times[0]:.1f} s)",
        counted(len(drive.cameras), "camera"),
        counted(len(drive.lidars), "LiDAR"),
        counted(len(drive.actors), "actor") + (f" ({most}{others})" if labels else ""),
    ]
    trained = "no trained scene" if source.scene_path is None else f"trained scene {source.scene_path.name}"
    images = "" if source.log is not None else "; the log itself is not at hand"
    return f"Imported {source.log_path.name}: {', '.join(parts)}; {trained}{images}"


def counted(number: int, what: str) -> str:
    """Return a number and what it counts, in the plural where there is not one."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
