"""What a recorded drive holds, as one line."""

from __future__ import annotations

from collections import Counter

from ..texts import Text, counted, series
from .source import DriveSource


def summary(source: DriveSource) -> str:
    """Return what a drive holds, as one line."""
    drive = source.drive
    labels = Counter(actor.label for actor in drive.actors.values())
    most: list[str] = [f"{count} {label}" for label, count in labels.most_common(3)]
    if len(labels) > 3:
        most.append(Text("{count} others", count=sum(labels.values()) - sum(n for _, n in labels.most_common(3))))
    times = sorted(drive.time_s.values())
    actors: str = counted(len(drive.actors), "1 actor", "{count} actors")
    if labels:
        actors = Text("{actors} ({classes})", actors=actors, classes=series(most))
    parts = [
        Text("{count} frames ({time:.1f} s)", count=len(times), time=times[-1] - times[0]),
        counted(len(drive.cameras), "1 camera", "{count} cameras"),
        counted(len(drive.lidars), "1 LiDAR", "{count} LiDARs"),
        actors,
    ]
    scene = source.scene_path
    trained = Text("no trained scene") if scene is None else Text("trained scene {name}", name=scene.name)
    what = [trained] if source.log is not None else [trained, Text("the log itself is not at hand")]
    return Text(
        "Imported {log}: {parts}; {what}", log=source.log_path.name, parts=series(parts), what=series(what, "; ")
    )
