"""An indexed job for Kubernetes."""

from __future__ import annotations

import json

from .scheduler import ShardedBatch, register

RETRIES = 3
"""So often an index is tried again: after a node is lost, or where a unit of it failed."""


@register
def kubernetes(batch: ShardedBatch) -> str:
    """Return a manifest for `kubectl apply -f`: an index for each shard. Scalars are JSON, which YAML contains."""
    command = batch.with_shard("$(JOB_COMPLETION_INDEX)")
    # $(NAME) in a command is a variable's value; $$ is a dollar
    words = [word.replace("$", "$$") for word in command[:-1]] + command[-1:]
    # Kubernetes takes GPUs as limits alone
    gpus = f"\n            limits:\n              nvidia.com/gpu: {batch.gpus}" if batch.gpus else ""
    lines = "\n".join(f"            - {json.dumps(word, ensure_ascii=False)}" for word in words)
    return f"""apiVersion: batch/v1
kind: Job
metadata:
  name: {json.dumps(batch.name.lower())}
spec:
  completionMode: Indexed
  completions: {batch.shards}
  parallelism: {batch.shards}
  backoffLimitPerIndex: {RETRIES}
  template:
    spec:
      restartPolicy: Never
      containers:
        - name: unisim
          image: {json.dumps(batch.image)}
          command:
{lines}
          resources:
            requests:
              cpu: {batch.processes}{gpus}
"""
