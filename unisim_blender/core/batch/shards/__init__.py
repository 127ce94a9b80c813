"""Batches divided into shards for schedulers of other tools: the files that those take.

Another scheduler is a file in this folder and a line here.
"""

from __future__ import annotations

from .scheduler import SCHEDULERS as SCHEDULERS
from .scheduler import ShardedBatch as ShardedBatch

# isort: off
from .slurm import slurm as slurm
from .kubernetes import kubernetes as kubernetes
from .openjd import openjd as openjd
from .flamenco import flamenco as flamenco
