"""An array script for SLURM."""

from __future__ import annotations

import shlex

from .scheduler import ShardedBatch, register


@register
def slurm(batch: ShardedBatch) -> str:
    """Return a script for `sbatch`: a task of the array for each shard."""
    words = shlex.join(batch.words)
    gpus = f"#SBATCH --gpus={batch.gpus}\n" if batch.gpus else ""
    return f"""#!/bin/bash
#SBATCH --job-name={batch.name}
#SBATCH --array=0-{batch.shards - 1}
#SBATCH --cpus-per-task={batch.processes}
{gpus}#SBATCH --output={batch.name}-%A-%a.log
#SBATCH --requeue
set -euo pipefail
exec {words} --units "$SLURM_ARRAY_TASK_ID/{batch.shards}"
"""
