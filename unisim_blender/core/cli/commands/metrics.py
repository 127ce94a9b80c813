"""`unisim metrics`: detections, forecasts and plans beside labels, or beside those on other sensor data."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..options import PATH


@click.command()
@click.argument("outputs", type=PATH)
@click.argument("labels", type=PATH)
@click.option(
    "--agreement", is_flag=True, help="LABELS are detections too, on other sensor data: compare with those, at IoU 0.3."
)
@click.option(
    "--label-score",
    default=0.5,
    show_default=True,
    help="With --agreement: the least score of a detection that is a label.",
)
@click.option(
    "--iou", "ious", metavar="A,B", help="IoU thresholds. [default: 0.1,0.3,0.5,0.7 and, for boxes from above, 0.8]"
)
@click.option(
    "--resamples", default=1000, show_default=True, type=click.IntRange(1), help="Resamples behind the intervals."
)
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="What the resamples are drawn from.")
@click.option("--out", type=PATH, help="File for all metrics, as JSON.")
def command(
    outputs: Path,
    labels: Path,
    agreement: bool,
    label_score: float,
    ious: str | None,
    resamples: int,
    seed: int,
    out: Path | None,
) -> None:
    """Measure the detections, forecasts and plans in OUTPUTS against LABELS, both JSON documents
    (docs/reference/metrics.md).

    Intervals hold 95 % of resamples of whole sequences, or of frames where there is one sequence alone.
    """
    from ...evaluation.autonomy.document import MetricsError, read_outputs
    from ...evaluation.autonomy.measure import AGREEMENT_IOU, confident, measure, metrics_table
    from ...files import write_file

    given, wanted = read_outputs(outputs), read_outputs(labels)
    thresholds: tuple[float, ...] | None = (AGREEMENT_IOU,) if agreement else None
    if ious is not None:
        thresholds = _thresholds(ious)
    metrics = measure(given, confident(wanted, label_score) if agreement else wanted, thresholds, resamples, seed)
    for line in metrics_table(metrics):
        click.echo(line)
    if out is not None:
        write_file(out, json.dumps(metrics, indent=1) + "\n", MetricsError)
        click.echo(f"Metrics: {out}")


def _thresholds(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(0 < value <= 1 for value in values):
        raise click.BadParameter(
            f"must be numbers above 0 and up to 1, separated by commas, not {text!r}", param_hint="--iou"
        )
    return values
