# SPDX-License-Identifier: Apache-2.0
"""Runs the processes of a launch until they have ended, or one end or a signal ends all."""
from __future__ import annotations

import asyncio
import contextlib
import signal

from ros2.launch.actions import ProcessPlan
from ros2.launch.log import Log
from ros2.launch.process import Process


class Service:
    """All processes of one launch."""

    def __init__(self, plans: list[ProcessPlan], log: Log, terminal: bool) -> None:
        """Do not start them yet.

        With `terminal`, and exactly one process whose output is the screen, that one gets the
        terminal itself, so that a live display works; the others then stay off the screen.
        """
        screens = [plan for plan in plans if plan.output == 'screen']
        direct = terminal and len(screens) == 1
        log.quiet = direct
        self._log = log
        self._quiet = direct
        self._processes = [
            Process(plan, log, own_terminal=direct and plan is screens[0], quiet=direct)
            for plan in plans]
        self._ending = asyncio.Event()
        self._status = 0
        self._interrupts = 0

    async def run(self) -> int:
        """Run all of them; return the status of the first that failed before the end had begun.

        It is 1 for one that a signal ended, and 0 when none has failed.
        """
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGINT, self._on_interrupt)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            # An ignored signal stays ignored: nohup ignores SIGHUP.
            if signal.getsignal(number) is not signal.SIG_IGN:
                loop.add_signal_handler(number, self._on_terminate, number)
        await asyncio.gather(*(self._keep(process) for process in self._processes))
        return self._status

    def _on_interrupt(self) -> None:
        again = ' again, ignoring...' if self._interrupts else ''
        self._interrupts += 1
        self._ending.set()
        self._log.message('WARNING', 'launch', f'user interrupted with ctrl-c (SIGINT){again}')

    def _on_terminate(self, number: signal.Signals) -> None:
        if not self._ending.is_set():
            self._ending.set()
            self._status = self._status or 1
            self._log.message('WARNING', 'launch', f'received {number.name}, shutting down')

    async def _keep(self, process: Process) -> None:
        """Run one process until it or the launch ends; start it again if it is to respawn."""
        status = 0
        while not self._ending.is_set():
            status = await self._once(process)
            delay = process.plan.respawn_delay
            if delay is None or process.plan.shutdown_on_exit:
                break
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._ending.wait(), delay)
        if self._ending.is_set():
            return
        if status != 0:
            self._status = self._status or max(status, 1)
            self._show_tail(process)
        if process.plan.shutdown_on_exit:
            self._ending.set()

    async def _once(self, process: Process) -> int:
        async def stop_at_end() -> None:
            await self._ending.wait()
            await process.stop()

        stopper = asyncio.create_task(stop_at_end())
        try:
            return await process.run()
        except OSError as error:
            self._log.message(
                'ERROR', process.plan.name,
                f"cannot start '{process.plan.command[0]}': {error.strerror}")
            return 1
        finally:
            stopper.cancel()

    def _show_tail(self, process: Process) -> None:
        """Show the last lines of a process that failed, unless they are on the screen already."""
        if process.plan.output != 'log' or not process.tail:
            return
        name = process.plan.name
        self._log.screen(f'[ERROR] [launch]: last lines of {name} '
                         f'(all of them in {self._log.folder / "launch.log"}):')
        for line in process.tail:
            self._log.screen(f'[{name}] {line}')
