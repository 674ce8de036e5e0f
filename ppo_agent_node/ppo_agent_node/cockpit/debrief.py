# SPDX-License-Identifier: Apache-2.0
"""What there is to say after a flight: how it went, why, and how the expert would have done."""
from __future__ import annotations

import math
from dataclasses import dataclass

from ppo_agent_node.cockpit.instruments import Brake
from ppo_agent_node.cockpit.instruments import Readings
from ppo_agent_node.flying.pilot import tell_begun
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec

_AT_MOST = 60.0
"""s, the longest flight of an expert that is waited for"""
WORDS = {
    'landed': 'LANDED', 'too_fast': 'CRASHED: too fast', 'tipped': 'TIPPED OVER',
    'off_pad': 'MISSED the pad', 'tilt_limit': 'LOST: tilted too far',
    'timeout': 'LOST: out of time', 'out_of_bounds': 'LOST: left the field',
    'crashed': 'CRASHED: the hull touched',
}
"""Outcomes as a pilot hears them"""


class Watch:
    """Looks for the moment at which full throttle was due, and when it came."""

    def __init__(self, brake: Brake) -> None:
        """Begin with a flight."""
        self._brake = brake
        self.last_chance: float | None = None
        """s into the flight, after which full throttle could not stop the fall in time"""
        self.lit: float | None = None
        """s, when the engine was first lit after that"""
        self.hit = 0.0
        """m/s at the ground, had full throttle begun when it was lit"""

    def see(self, time: float, readings: Readings, mass: float, throttle: float) -> None:
        """Look at a step."""
        speed = -readings.climb
        if self.last_chance is None:
            if speed <= 0 or readings.height <= 0:
                return
            if self._brake.height(speed, mass) <= readings.height:
                return
            self.last_chance = time
        if self.lit is None and throttle > 0:
            self.lit = time
            self.hit = self._brake.touchdown_speed(readings.height, speed, mass)

    def verdict(self) -> str:
        """Return what was late, in a line; empty when nothing was."""
        if self.last_chance is None:
            return ''
        told = f'the last chance for full throttle was at {self.last_chance:.2f} s'
        if self.lit is None:
            return f'{told}; the engine stayed off'
        late = self.lit - self.last_chance
        if late < 1e-9:
            return f'{told}: from then on every instant below full was lost'
        return f'{told}; lit {late:.2f} s later it means {self.hit:.0f} m/s at the ground'


@dataclass(frozen=True)
class FlightSummary:
    """How a flight ended."""

    outcome: str
    episode_return: float
    seconds: float
    speed: float
    """m/s at touchdown, as `tilt` in deg and `distance` in m from the pad's centre"""
    tilt: float
    distance: float
    fuel: float
    """kg used"""

    @classmethod
    def of(cls, episodes: Episodes, index: int, spec: WorldSpec) -> FlightSummary:
        """Return one of the episodes that ended."""
        return cls(
            spec.outcomes[int(episodes.outcome[index])], float(episodes.episode_return[index]),
            float(episodes.length[index]) * spec.dt, float(episodes.touchdown_speed[index]),
            float(episodes.tilt[index]), float(episodes.distance[index]),
            float(episodes.fuel_used[index]))

    @property
    def landed(self) -> bool:
        """Whether it landed."""
        return self.outcome == 'landed'

    def figures(self) -> str:
        """Return speed, tilt and distance in words."""
        return f'{self.speed:.2f} m/s, {self.tilt:.1f} °, {self.distance:.1f} m off the centre'


class ExpertFlight:
    """How the scripted pilot of a world does from the start of a reset; flown bit by bit."""

    def __init__(self, spec: WorldSpec, seed: int, **chosen: float) -> None:
        """Begin it.

        :param spec: of the simulator; its first vehicle is meant.
        :param chosen: settings of the reset.
        """
        self.flight: FlightSummary | None = None
        """How it ended; None before, or when no expert flies this vehicle"""
        settings = worlds.settings_from(spec.name, {**spec.settings, **chosen})
        self._left = math.ceil(_AT_MOST / spec.dt)
        try:
            self._world = worlds.make(spec.name, 1, seed, **settings)
            self._pilot = scripted_pilot(self._world.spec)
            self._observation = self._world.reset(seed)
            tell_begun(self._pilot)
        except ValueError:
            self._left = 0

    def go_on(self, steps: int = 20) -> bool:
        """Fly some steps; return whether it is over."""
        for _ in range(min(steps, self._left)):
            self._observation, _, terminated, truncated, info = self._world.step(
                self._pilot(self._observation))
            self._left -= 1
            if (terminated | truncated).any():
                self.flight = FlightSummary.of(info['episodes'], 0, self._world.spec)
                self._left = 0
                break
        return self._left <= 0


def debrief(
    flight: FlightSummary, expert: FlightSummary | None, watch: Watch,
) -> list[tuple[str, str]]:
    """Return lines about a flight: style and text."""
    good = 'bold green' if flight.landed else 'bold red'
    lines = [
        (good, f'{WORDS.get(flight.outcome, flight.outcome)}   {flight.figures()}'),
        ('', f'return {flight.episode_return:7.1f}   {flight.seconds:5.2f} s   '
             + (f'fuel {flight.fuel:.0f} kg' if flight.fuel else '')),
    ]
    if expert is not None:
        lines.append(('dim', (
            f'expert {expert.episode_return:7.1f}   {expert.seconds:5.2f} s   '
            + (f'fuel {expert.fuel:.0f} kg   ' if expert.fuel else '') + expert.figures())))
    if not flight.landed and (why := watch.verdict()):
        lines.append(('bold yellow', why))
    return lines
