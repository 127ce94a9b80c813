"""A job template of Open Job Description, which AWS Deadline Cloud and others run."""

from __future__ import annotations

import json

from ...errors import UnisimError
from .scheduler import ShardedBatch, register


@register
def openjd(batch: ShardedBatch) -> str:
    """Return a template for `openjd run`, as JSON: a task for each shard. Raises `UnisimError`."""
    for word in batch.words:
        if "{{" in word:
            raise UnisimError(f"{word}: has {{{{, which begins a value in a template of Open Job Description")
    command, *arguments = batch.with_shard("{{Task.Param.Shard}}")
    amounts = [{"name": "amount.worker.vcpu", "min": batch.processes}]
    amounts += [{"name": "amount.worker.gpu", "min": batch.gpus}] if batch.gpus else []
    shard = {"name": "Shard", "type": "INT", "range": f"0-{batch.shards - 1}" if batch.shards > 1 else [0]}
    template = {
        "specificationVersion": "jobtemplate-2023-09",
        "name": batch.name,
        "steps": [
            {
                "name": "Shards",
                "parameterSpace": {"taskParameterDefinitions": [shard]},
                "script": {"actions": {"onRun": {"command": command, "args": arguments}}},
                "hostRequirements": {"amounts": amounts},
            }
        ],
    }
    return json.dumps(template, indent=2) + "\n"
