# SPDX-License-Identifier: Apache-2.0
"""Debriefing after a flight: result, timing of the burn, and comparison with the expert."""
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
"""Maximum length, s, of an expert's flight."""
WORDS = {
    'landed': 'LANDED', 'too_fast': 'CRASHED: too fast', 'tipped': 'TIPPED OVER',
    'off_pad': 'MISSED the pad', 'tilt_limit': 'LOST: tilted too far',
    'timeout': 'LOST: out of time', 'out_of_bounds': 'LOST: left the field',
    'crashed': 'CRASHED: the hull touched',
}
"""Outcomes in words."""


class Watch:
    """Records when full throttle was due, and when it was applied."""

    def __init__(self) -> None:
        """Start a flight."""
        self.last_chance: float | None = None
        """s into the flight, after which full throttle could not stop the fall in time."""
        self.lit: float | None = None
        """s, when the engine was first lit after that."""
        self.hit = 0.0
        """m/s at the ground, had full throttle begun at that ignition."""

    def see(
        self, time: float, readings: Readings, brake: Brake, mass: float, throttle: float,
    ) -> None:
        """Process a step.

        :param brake: braking model of the flight's vehicle.
        """
        speed = -readings.climb
        if self.last_chance is None:
            if speed <= 0 or readings.height <= 0:
                return
            if brake.height(speed, mass) <= readings.height:
                return
            self.last_chance = time
        if self.lit is None and throttle > 0:
            self.lit = time
            self.hit = brake.touchdown_speed(readings.height, speed, mass)

    def verdict(self) -> str:
        """Return a line on what was late; empty if nothing was."""
        if self.last_chance is None:
            return ''
        last_chance = f'the last chance for full throttle was at {self.last_chance:.2f} s'
        if self.lit is None:
            return f'{last_chance}; the engine stayed off'
        late = self.lit - self.last_chance
        if late < 1e-9:
            return f'{last_chance}; the engine was lit, but needed full throttle from then on'
        return (f'{last_chance}; the engine was lit {late:.2f} s later: '
                f'at least {self.hit:.0f} m/s at the ground')


@dataclass(frozen=True)
class FlightSummary:
    """Results of a flight."""

    outcome: str
    episode_return: float
    seconds: float
    speed: float
    """m/s at touchdown, like `tilt` in deg and `distance` in m from the pad's centre."""
    tilt: float
    distance: float
    fuel: float
    """kg used."""

    @classmethod
    def of(cls, episodes: Episodes, index: int, spec: WorldSpec) -> FlightSummary:
        """Return the summary of one of the ended episodes."""
        return cls(
            spec.outcomes[int(episodes.outcome[index])], float(episodes.episode_return[index]),
            float(episodes.length[index]) * spec.dt, float(episodes.touchdown_speed[index]),
            math.degrees(episodes.tilt[index]), float(episodes.distance[index]),
            float(episodes.fuel_used[index]))

    @property
    def landed(self) -> bool:
        """Whether it landed."""
        return self.outcome == 'landed'

    def figures(self) -> str:
        """Return speed, tilt and distance as text."""
        return f'{self.speed:.2f} m/s, {self.tilt:.1f} °, {self.distance:.1f} m off the centre'


class ExpertFlight:
    """The scripted pilot's flight from the start of a reset, flown in small portions."""

    def __init__(self, spec: WorldSpec, seed: int, **chosen: float) -> None:
        """Start the flight.

        :param spec: of the simulator, whose first vehicle is flown.
        :param chosen: settings of the reset.
        """
        self.flight: FlightSummary | None = None
        """Its result; None before its end, or if no expert supports the vehicle."""
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
        """Fly some steps; return whether the flight is over."""
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
    """Return lines on a flight: style and text."""
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
