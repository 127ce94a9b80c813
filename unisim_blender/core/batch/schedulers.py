"""Batches divided into shards for the schedulers of other tools: the file that each of those takes.

Another scheduler is a function here that is registered.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..errors import UnisimError
from ..registry import Registry

KUBERNETES_RETRIES = 3
"""Number of times that an index is tried again: after a node is lost, or where a unit of it failed."""


@dataclass(frozen=True)
class ShardedBatch:
    """A batch in ``shards`` parts. ``words`` are its command with all options but which shard; paths in it are whole.

    ``name`` has letters, digits and dashes alone. ``processes`` are those of a shard, which share its ``gpus``. ``image`` is
    that of containers.
    """

    name: str
    words: Sequence[str]
    shards: int
    processes: int = 1
    image: str = "unisim"
    gpus: int = 0

    def with_shard(self, number: str) -> list[str]:
        """Return the command of the shard of a number, as the scheduler writes it in."""
        return [*self.words, "--units", f"{number}/{self.shards}"]


WriteJob = Callable[[ShardedBatch], str]
SCHEDULERS: Registry[WriteJob] = Registry("a scheduler", key="__name__")
"""Functions that write the file that a scheduler takes, by their names."""
register = SCHEDULERS.register


@register
def slurm(batch: ShardedBatch) -> str:
    """Return an array script for SLURM's `sbatch`: a task for each shard."""
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


@register
def kubernetes(batch: ShardedBatch) -> str:
    """Return the manifest of an indexed job for Kubernetes, for `kubectl apply -f`: an index for each shard. Scalars are
    JSON, which YAML contains."""
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
  backoffLimitPerIndex: {KUBERNETES_RETRIES}
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


@register
def openjd(batch: ShardedBatch) -> str:
    """Return a template of Open Job Description, which AWS Deadline Cloud and others run, for `openjd run`, as JSON: a task for
    each shard. Raises `UnisimError`."""
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


@register
def flamenco(batch: ShardedBatch) -> str:
    """Return a job type of Flamenco, Blender's render farm, a script for its manager's folder `scripts`: a task for each shard,
    which workers run by the command `exec`."""
    program, *arguments = batch.words
    return f"""const JOB_TYPE = {{
  label: {json.dumps(f"UniSim batch {batch.name}")},
  settings: [
    {{ key: "shards", type: "int32", default: {batch.shards}, description: "Tasks that the batch is divided into" }},
  ],
}};

const PROGRAM = {json.dumps(program)};
const ARGUMENTS = {json.dumps(arguments)};

function compileJob(job) {{
  const shards = job.settings.shards;
  for (let shard = 0; shard < shards; shard++) {{
    const task = author.Task(`shard-${{shard}}`, "misc");
    const args = ARGUMENTS.concat(["--units", `${{shard}}/${{shards}}`]);
    task.addCommand(author.Command("exec", {{ exe: PROGRAM, args: args }}));
    job.addTask(task);
  }}
}}
"""
