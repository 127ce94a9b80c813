"""A job type of Flamenco, Blender's render farm."""

from __future__ import annotations

import json

from .scheduler import ShardedBatch, register


@register
def flamenco(batch: ShardedBatch) -> str:
    """Return a script for the manager's folder `scripts`: a task for each shard, which workers run by the command `exec`."""
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
