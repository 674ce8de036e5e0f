# SPDX-License-Identifier: Apache-2.0
"""Headless rendering of recordings to images, by the viewer."""
from __future__ import annotations

import io
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.rerun_program import LOCAL
from rocket_sim_node.recording.sinks.rewrite import rewrite
from rocket_sim_node.scratch_folder import scratch_folder

BARS = (36, 32)
"""Heights of the viewer's top and bottom bars, pixels."""
HINT = (
    'a Vulkan driver is missing; install one that needs no graphics card: '
    'apt-get install --no-install-recommends mesa-vulkan-drivers')


class RendererMissing(rerun_program.ViewerError):
    """There is no graphics driver for rendering."""


def render(
    recording: Path, times: Sequence[float], *, size: tuple[int, int] = (1600, 900),
    tab: str = 'flight', patience: float = 30.0,
) -> list[Image.Image]:
    """Return the viewer's images of a recording at some times (s on `sim_time`).

    On the tab 'training', times are iterations instead.

    :param size: of the window, pixels; its bars are cropped from the images.
    :param patience: time limit of each step, s.
    :raises RendererMissing: when this machine has no graphics driver.
    :raises rerun_program.ViewerError: when the viewer fails, or a view of it reports an error.
    """
    port = rerun_program.free_port()
    with scratch_folder() as folder:
        shown = recording
        if tab != 'flight':
            shown = folder / 'shown.rrd'
            rewrite(recording, shown, tab)
        program = rerun_program.Program(
            '--headless', '--bind', LOCAL, '--port', str(port), '--hide-welcome-screen',
            '--window-size', f'{size[0]}x{size[1]}', XDG_RUNTIME_DIR=str(folder),
            TMPDIR=str(folder))
        try:
            try:
                program.wait_for(
                    lambda: rerun_program.reachable(LOCAL, port), 'the viewer', patience)
                client = ViewerClient.connect(f'rerun+http://{LOCAL}:{port}/proxy')
                client.open(str(shown.absolute()))
                _wait_for_load(client, patience)
            except (rerun_program.ViewerError, RuntimeError, ConnectionError) as error:
                said = program.said(10_000)
                if 'render context' in said or 'adapter' in said:
                    raise RendererMissing(HINT) from error
                raise rerun_program.ViewerError(f'{error} {program.said()}') from error
            pictures = []
            for moment in times:
                if tab == 'training':
                    client.set_time('iteration', sequence=int(moment), play_state='paused')
                else:
                    client.set_time('sim_time', duration=float(moment), play_state='paused')
                pictures.append(_settled(client, patience))
            _complain(client)
            return pictures
        finally:
            program.stop()


def _wait_for_load(client: ViewerClient, patience: float) -> None:
    """Wait until the viewer has loaded the recording."""
    deadline = time.monotonic() + patience
    state = client.get_state()
    while state.loading or state.active_recording is None:
        if time.monotonic() > deadline:
            raise rerun_program.ViewerError(
                f'the viewer has not read the recording in {patience:g} s')
        time.sleep(0.1)
        state = client.get_state()


def _settled(client: ViewerClient, patience: float) -> Image.Image:
    """Return the image once it no longer changes."""
    deadline = time.monotonic() + patience
    last, same = b'', 0
    while same < 2 and time.monotonic() < deadline:
        now = client.take_screenshot()
        same = same + 1 if now == last else 0
        last = now
        time.sleep(0.1)
    picture = Image.open(io.BytesIO(last)).convert('RGB')
    return picture.crop((0, BARS[0], picture.width, picture.height - BARS[1]))


def _complain(client: ViewerClient) -> None:
    """Raise the errors that the viewer displays."""
    complaints = [
        f'{view.name}: {report.summary} {report.details or ""}'
        for view in client.get_state().views for report in view.reports
        if report.severity == 'error']
    complaints += [entry.message for entry in client.get_logs() if entry.level == 'ERROR']
    if complaints:
        raise rerun_program.ViewerError('the viewer reports: ' + '; '.join(complaints))
