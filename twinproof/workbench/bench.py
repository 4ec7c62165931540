"""What all requests share: the project, the worker, and what is to be done after this."""

from __future__ import annotations

import asyncio

from foundation.errors import InputError
from twinproof.workbench.project import Project
from twinproof.workbench.worker import Job, Worker


class Workbench:
    """A project that is being worked on: one task at a time.

    Args:
        project: The folder.
        loop: In which what was to come is begun.
    """

    def __init__(self, project: Project, loop: asyncio.AbstractEventLoop) -> None:
        self.project = project
        self._loop = loop
        self._look_again = False
        self._next: tuple[str, dict[str, str]] | None = None
        self._ended: Job | None = None
        self.worker = Worker(project.folder, self._finished)

    def look(self) -> None:
        """Look at what was chosen, now or once the running task is done."""
        self._look_again = not self.worker.run("look")

    def begin(self, task: str, arguments: dict[str, str]) -> None:
        """Begin a task, at once or after a look that is being taken.

        Raises:
            InputError: Another one is running.
        """
        if self._next is None:
            if self.worker.run(task, arguments):
                return
            job = self.worker.job
            if job is not None and job.task == "look":
                self._next = (task, arguments)
                return
        raise InputError("another computation is running", remedy="wait for it, or cancel it first")

    def cancel(self) -> None:
        """End what is running, and forget what was to come."""
        self._next = None
        self.worker.cancel()

    @property
    def job(self) -> Job | None:
        """The task that runs, or ran last; one that waits its turn is running. A look is none."""
        if self._next is not None:
            return Job(self._next[0])
        present = self.worker.job
        return self._ended if present is None or present.task == "look" else present

    @property
    def looking(self) -> bool:
        """A look is being taken, or waits its turn."""
        present = self.worker.job
        taken = present is not None and present.running and present.task == "look"
        return taken or self._look_again

    def _finished(self, job: Job) -> None:
        if job.task != "look":
            self._ended = job
        # In a moment: the worker's lock is still held by who tells us.
        self._loop.call_soon_threadsafe(self._go_on)

    def _go_on(self) -> None:
        if self._next is not None:
            task, arguments = self._next
            if self.worker.run(task, arguments):
                self._next = None
        elif self._look_again:
            self.look()
