# SPDX-License-Identifier: Apache-2.0
"""Hand flying: keys to actions step by step, and instruments back to the terminal."""
from __future__ import annotations

import math
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import replace
from typing import Any

import numpy as np
from rclpy.node import Node
from rocket_msgs import msg

from ppo_agent_node.cockpit.debrief import ExpertFlight
from ppo_agent_node.cockpit.debrief import FlightSummary
from ppo_agent_node.cockpit.debrief import Watch
from ppo_agent_node.cockpit.debrief import debrief
from ppo_agent_node.cockpit.display import Cockpit
from ppo_agent_node.cockpit.display import Tank
from ppo_agent_node.cockpit.display import View
from ppo_agent_node.cockpit.instruments import Brake
from ppo_agent_node.cockpit.instruments import checked
from ppo_agent_node.cockpit.instruments import read
from ppo_agent_node.cockpit.key_bindings import HELP
from ppo_agent_node.cockpit.key_bindings import NEXT
from ppo_agent_node.cockpit.key_bindings import QUIT
from ppo_agent_node.cockpit.key_bindings import KeyboardCommands
from ppo_agent_node.cockpit.raw_terminal import RawTerminal
from ppo_agent_node.config.curriculum_config import level_setting
from ppo_agent_node.pilots.keyboard import KeyboardPilot
from rocket_sim_node import settings
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.invalid_input import ignore_invalid_input
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.rocket import conditions

_FRAME = 1 / 15
"""Seconds between screen updates in flight."""
_IDLE = 0.05
"""Seconds between checks of the keys between flights."""
_LOST = (SimulatorBusy, WireTimeout, EnvironmentRestarted)
_NEXT = ('', 'r: next start   t: this start again   h: help   q: quit')


@dataclass(frozen=True)
class EpisodeStart:
    """Start of flights."""

    seed: int
    level: int
    """0: the world has no levels, or the simulator's own."""

    @property
    def settings(self) -> dict[str, float]:
        """Reset settings."""
        return level_setting(self.level)


class HandFlying:
    """Flights of one person at one terminal.

    Each begins with a reset on the person's command. Between flights control of the simulator is
    released, and the world does not advance.
    """

    def __init__(
        self, node: Node, client: Client, terminal: RawTerminal, cockpit: Cockpit,
        pilot: KeyboardPilot, start: EpisodeStart, place: str,
    ) -> None:
        """Store the components; `client` is connected.

        :param place: address of the live view, or ''.
        :raises ValueError: when the world's settings are impossible for a vehicle; names them.
        """
        self._node, self._client, self._terminal = node, client, terminal
        self._cockpit, self._pilot, self._start = cockpit, pilot, start
        self._spec = spec = checked(client.spec)
        self._brake = Brake.of(spec)
        self._keys = KeyboardCommands(pilot)
        self._expert: ExpertFlight | None = None
        self._flights = Counter[str]()
        self._best = float('-inf')
        s = spec.settings
        fuel, dry_mass = s.get('fuel', 0.0), self._brake.dry_mass
        self._full = Tank(dry_mass + fuel, fuel, fuel, 0.0, 0.0, self._brake)
        self._dry_masses, self._most_fuel = _drawn_masses(spec, dry_mass, fuel)
        self._tank = self._full
        self._drawn = 0.0
        self._view = View(
            '', max(s.get('spawn_height', 14.0) - s.get('touchdown_height', 0.0), 1.0),
            tuple(s.get(f'landed_{name}', 0.0)  # type: ignore[arg-type]
                  for name in ('speed', 'tilt', 'distance')),
            help=True)
        self._view.notes = [('bold green', 'press r to fly')]
        if place:
            self._view.notes.insert(0, ('', f'watch it: {place}'))
        self._subscription = node.create_subscription(
            msg.RocketState, 'state', self._on_state, qos.EVENTS)

    def run(self) -> None:
        """Run flight after flight until stopped."""
        start, flown = self._start, False
        command = self._rest(start)
        while command != QUIT:
            if command == NEXT and flown:
                start = replace(start, seed=start.seed + 1)
            flown = True
            command = self._fly(start) or self._rest(start)

    def summary(self) -> str:
        """Return a summary of the flights; empty before the first."""
        total = sum(self._flights.values())
        if not total:
            return ''
        return f'landed {self._flights["landed"]} of {total}, best return {self._best:.1f}'

    # Between flights

    def _rest(self, start: EpisodeStart) -> str:
        """Wait for the person's next command."""
        view = self._view
        view.flying = False
        self._draw(start)
        while True:
            for command in self._commands(0.0 if self._expert else _IDLE):
                if command != HELP:
                    return command
                view.help = not view.help
                self._draw(start)
            if stopping.requested():
                raise EnvironmentClosed('asked to stop')
            self._let_the_expert_fly()
            if self._take_errors() or time.monotonic() - self._drawn > 1.0:
                self._draw(start)

    def _commands(self, seconds: float = 0.0) -> list[str]:
        """Read the keys: controls go to the pilot, commands are returned.

        :raises EnvironmentClosed: when the terminal has gone.
        """
        data = self._terminal.read(seconds)
        if data is None:
            raise EnvironmentClosed('the terminal was closed')
        return self._keys.take(data, time.monotonic())

    def _take_errors(self) -> bool:
        """Show the last line of the log; return whether there was one."""
        lines = [line for line in self._terminal.errors() if line.strip()]
        if lines:
            self._view.message = lines[-1]
        return bool(lines)

    # In flight

    def _fly(self, start: EpisodeStart) -> str | None:
        """Fly from a start; return the command that aborted the flight, if one did."""
        view = self._view
        view.help, view.flying, view.notes, view.message = False, True, [], ''
        self._expert = None
        try:
            self._tank = self._full
            self._pilot.reset()
            observation = self._client.reset(start.seed, **start.settings)
            return self._steer(start, observation)
        except _LOST as error:
            view.notes = [('bold red', str(error)), ('', 'r: fly   q: quit')]
        finally:
            # Release control: the simulator waits, and other agents may take it.
            self._client.close()
        return None

    def _steer(self, start: EpisodeStart, observation: F32) -> str | None:
        watch = Watch()
        due = time.monotonic()
        steps = 0
        while True:
            commands = [c for c in self._commands() if c != HELP]
            if commands:
                return commands[0]
            now = time.monotonic()
            action = self._pilot.act(observation, now)
            observation, _, _, _, info = self._client.step(action)
            steps += 1
            mine = (info['final_rows'] == 0).nonzero()[0]
            seen = info['final_observation'][mine[0]] if mine.size else observation[0]
            self._view.readings = readings = read(self._spec, seen)
            if mine.size:
                self._touch_down(start, info, watch)
                return None
            # In lock-step the state arrives many steps at a time, and thus late.
            flown = self._tank.time if self._client.realtime else steps * self._spec.dt
            tank = self._tank
            watch.see(flown, readings, tank.brake, tank.mass, self._pilot.throttle(now))
            if now - self._drawn > _FRAME:
                self._take_errors()
                self._draw(start)
            if not self._client.realtime:
                due = max(due + self._spec.dt, time.monotonic() - self._spec.dt)
                time.sleep(max(due - time.monotonic(), 0.0))

    def _touch_down(self, start: EpisodeStart, info: dict[str, Any], watch: Watch) -> None:
        """Report the end of a flight."""
        rows = np.flatnonzero(info['episodes'].row == 0)
        if not rows.size:
            self._view.notes = [('', 'the outcome was not received'), ('', ''), _NEXT]
            return
        flight = FlightSummary.of(info['episodes'], int(rows[0]), self._spec)
        self._flights[flight.outcome] += 1
        self._best = max(self._best, flight.episode_return)
        self._flown = flight, watch
        self._expert = ExpertFlight(self._spec, start.seed, **start.settings)
        self._report()

    def _report(self, expert: FlightSummary | None = None) -> None:
        """Show the debriefing below the instruments."""
        self._view.notes = [
            *debrief(self._flown[0], expert, self._flown[1]), ('', ''), _NEXT]

    def _let_the_expert_fly(self) -> None:
        """Advance the expert's flight by a few steps, so that keys are handled in between."""
        if self._expert is None:
            return
        over = True
        with suppress(ValueError):  # the expert may not support this vehicle
            over = self._expert.go_on()
        if over:
            self._report(self._expert.flight)
            self._expert = None
            self._drawn = 0.0

    def _draw(self, start: EpisodeStart) -> None:
        self._drawn = time.monotonic()
        level = f' · level {start.level}' if start.level else ''
        self._view.title = f'hoverslam · {self._spec.name}{level} · start {start.seed}'
        self._view.summary = self.summary()
        self._view.tank = self._tank
        self._terminal.draw(self._cockpit.lines(self._view))

    def _on_state(self, message: msg.RocketState) -> None:
        """Store unobserved quantities of the first vehicle in the current flight."""
        if message.session != self._client.session:
            return
        with ignore_invalid_input(self._node, 'state'):
            samples = samples_of(message)
            mine = samples.values[(samples.row == 0) & (samples.episode == 0)]
            if len(mine):
                self._tank = self._tank_of(mine[-1])

    def _tank_of(self, sample: F64) -> Tank:
        """Return the quantities of a sample.

        :param sample: `(D,)`; see :data:`FIELDS`.
        :raises ValueError: for impossible values of this vehicle, naming them.
        """
        (lightest, heaviest), most = self._dry_masses, self._most_fuel
        seen = {}
        for name, low, high in (
                ('mass', lightest, heaviest + most), ('fuel', 0.0, most),
                ('throttle', 0.0, 1.0), ('time', 0.0, math.inf)):
            seen[name] = value = float(sample[FIELDS[name].start])
            if not low <= value <= high:
                raise ValueError(f'{name}: got {value:g}, expected {low:g} to {high:g}')
        brake = replace(self._brake, dry_mass=max(seen['mass'] - seen['fuel'], lightest))
        return Tank(full=self._full.full, brake=brake, **seen)


def _drawn_masses(
    spec: WorldSpec, dry_mass: float, fuel: float,
) -> tuple[tuple[float, float], float]:
    """Return the range of the dry mass and the maximum of the fuel that episodes may draw, kg.

    :param dry_mass: kg, nominal, like `fuel`.
    :raises ValueError: when the end of a range of conditions is below its beginning.
    """
    if not set(conditions.FLAT_NAMES) <= set(spec.settings):
        return (dry_mass, dry_mass), fuel
    drawn = settings.build(conditions.ConditionSettings, {
        name: spec.settings[name] for name in conditions.FLAT_NAMES})
    lightest, heaviest = drawn.drawn_range('dry_mass_factor')
    return (dry_mass * lightest, dry_mass * heaviest), fuel * drawn.drawn_range('fuel_factor')[1]
