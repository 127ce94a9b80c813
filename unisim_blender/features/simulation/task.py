"""A rollout that runs in the background: a driver in the closed loop of a scene's scenario."""

from __future__ import annotations

from ...editing.simulation.rollouts import count_steps
from ...process.tasks import SequenceTask
from ...translations import message


class RolloutTask(SequenceTask):
    """A rollout in its folder; ``total`` are its steps. Cancelled and started again, it goes on with the steps that are
    missing."""

    @property
    def done(self) -> float:
        """Steps that are finished."""
        return float(count_steps(self.folder))

    def measure(self) -> str:
        """Steps of how many."""
        return message("{done} of {total} steps", done=int(self.done), total=int(self.total))

    def speed(self, rate: float) -> str:
        """Steps a second."""
        return message(", {rate:.2f} steps/s", rate=rate)
