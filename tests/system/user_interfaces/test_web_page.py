# SPDX-License-Identifier: Apache-2.0
"""The live web page in a real browser: it shows the current flight and past ones."""
from __future__ import annotations

import os
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from support.processes import Processes
from support.users.browser import Browser
from support.users.browser import BrowserMissing

from rocket_sim_node import palette
from rocket_sim_node.recording.sinks import rerun_program

PATIENCE = 100.0
"""s for a picture; two cores draw it in software, beside whatever else they have to do. All
waiting in the test together is less than its time-out, so that it ends by saying what is missing.
"""

ELSEWHERE = {'fonts.googleapis.com', 'app.rerun.io', 'api.github.com', 'tel.rerun.io'}
"""Hosts that Rerun's page asks: for a font, for lists of examples and versions, and to count its
users. It must do without them."""


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    """A browser. Without one the test is skipped, but fails in continuous integration."""
    try:
        started = Browser(tmp_path, (900, 640))
    except BrowserMissing as error:
        if os.environ.get('CI') == 'true':
            raise
        pytest.skip(str(error))
    yield started
    started.close()


def shows_a_flight(picture: Image.Image) -> bool:
    """Return whether sky, ground, pad, lander and plots are there, and no view complains."""
    pixels = np.asarray(picture, np.int64)[80:-40]
    half = int(0.6 * picture.width)
    scene, plots = pixels[:, :half], pixels[:, half:]

    def like(part: np.ndarray, colour: tuple[int, int, int]) -> int:
        return int((np.abs(part - colour).sum(axis=2) < 40).sum())

    red, green, blue = np.moveaxis(scene, 2, 0)
    # The lander's violet; the label with the result may lie on it like mist.
    lander = (blue - green > 35) & (red > green) & (blue > 100)
    return (
        like(scene, (16, 20, 30)) > 3000 and like(scene, (112, 116, 126)) > 3000
        and like(scene, palette.TARGET) > 30 and int(lander.sum()) > 100
        and like(plots, palette.SKY) > 60 and like(plots, palette.ORANGE) > 60
        and not complains(picture))


def complains(picture: Image.Image) -> bool:
    """Return whether there is the badge with which the viewer marks a view that has an error."""
    red, green, blue = np.moveaxis(np.asarray(picture, np.int64), 2, 0)
    return bool(((red > 220) & (green < 30) & (blue > 60) & (blue < 120)).any())


def still(seen: Callable[[Image.Image], bool]) -> Callable[[Image.Image], bool]:
    """Return whether the picture shows something and no longer changes."""
    before: list[Image.Image] = []

    def seen_again(now: Image.Image) -> bool:
        same = bool(before) and not differ(now, before[-1])
        before.append(now)
        return same and seen(now)

    return seen_again


@pytest.mark.timeout(420)
def test_the_page_shows_past_and_current_flights(
    processes: Processes, browser: Browser, tmp_path: Path,
) -> None:
    port = rerun_program.free_port()
    recorder = processes.run_node(
        'rocket_sim_node', 'rerun_recorder', serve_web=True, web_port=port)
    recorder.wait_for('watch it in a browser: http', 30.0)
    page = recorder.output().partition('watch it in a browser: ')[2].split()[0]
    assert page.startswith(f'http://127.0.0.1:{port}/')
    # In lock-step and with pauses: a page that draws without end would occupy both cores.
    processes.run_node('rocket_sim_node', 'simulator', world='lunar_lander', num_envs=1)
    recorder.wait_for('streaming to', 30.0)  # it hears the simulator: no flight escapes it

    def fly(seed: int) -> None:
        pilot = processes.run_node('ppo_agent_node', 'expert_pilot', episodes=1, seed=seed)
        assert pilot.wait(40.0) == 0, pilot.output()

    fly(1)
    browser.open(page, 30.0)  # comes late: nothing flies any more
    flown = browser.wait_for(still(shows_a_flight), PATIENCE, 'past flight')
    flown.save(tmp_path / 'flown.png')

    fly(2)
    browser.wait_for(
        lambda now: shows_a_flight(now) and differ(now, flown), PATIENCE, 'new flight',
    ).save(tmp_path / 'flies.png')

    assert recorder.running
    # The browser of this test reaches no other machine: what the page wants there, it did without.
    hosts = {urlsplit(url).hostname for url in browser.requests} - {None, '', '127.0.0.1'}
    assert hosts <= ELSEWHERE
    unreachable = ('net::ERR_NAME_NOT_RESOLVED', 'TypeError: Failed to fetch')
    assert [
        text for text in browser.console if not any(words in text for words in unreachable)] == []
    assert any(urlsplit(url).path.endswith('.wasm') for url in browser.requests)


def differ(one: Image.Image, other: Image.Image) -> bool:
    """Return whether another landing is seen: more than a blinking cursor is different."""
    apart = np.asarray(one, np.int64) - np.asarray(other, np.int64)
    return int((np.abs(apart).sum(axis=2) > 60).sum()) > 2000
