# SPDX-License-Identifier: Apache-2.0
"""A real headless browser, controlled over the DevTools protocol.

The protocol is JSON. Chromium also supports it over a pair of pipes, with a zero byte after each
message, so neither a driver program nor a web socket is needed.
"""
from __future__ import annotations

import base64
import io
import json
import os
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from PIL import Image

NAMES = ('chromium', 'chromium-browser', 'google-chrome')
_FLAGS = (
    '--headless=new', '--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
    '--disable-dev-shm-usage', '--no-first-run', '--no-default-browser-check', '--disable-quic',
    '--disable-background-networking', '--disable-component-update', '--disable-sync',
    '--disable-extensions', '--disable-default-apps', '--metrics-recording-only', '--mute-audio',
    '--no-proxy-server', '--hide-scrollbars',
    # The page may only contact this machine.
    '--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1',
)


_SHOT = 25.0
"""s; time limit for one picture, after which another is requested"""
_PAUSE = 2.0
"""s between pictures, because the page is redrawn for each"""


class Late(AssertionError):
    """The browser did not answer in time."""


class BrowserMissing(RuntimeError):
    """No browser is installed."""


def program() -> str:
    """Return the browser that is installed.

    :raises BrowserMissing: if there is none.
    """
    for name in NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    raise BrowserMissing(
        f'none of {", ".join(NAMES)} is installed: '
        'apt-get install --no-install-recommends chromium')


class Browser:
    """One page of a browser with an empty profile, and its reports.

    `console` has the errors of the page and its scripts, `requests` every requested address.
    """

    def __init__(self, folder: Path, size: tuple[int, int] = (1280, 800)) -> None:
        """Start the browser, with its profile and its log in `folder`.

        :raises BrowserMissing: if no browser is installed.
        """
        command = [
            program(), *_FLAGS, f'--user-data-dir={folder / "profile"}',
            f'--window-size={size[0]},{size[1]}', '--remote-debugging-pipe', 'about:blank']
        theirs_in, self._write = os.pipe()
        self._read, theirs_out = os.pipe()
        self.log = folder / 'browser.log'
        # It reads from descriptor 3 and writes to 4; a shell redirects these to the pipes.
        with self.log.open('wb') as log:
            self._child = subprocess.Popen(
                ['bash', '-c', f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}', 'browser', *command],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                pass_fds=(theirs_in, theirs_out), env={**os.environ, 'HOME': str(folder)})
        os.close(theirs_in)
        os.close(theirs_out)
        self.console: list[str] = []
        self.requests: list[str] = []
        self._pending = b''
        self._number = 0
        self._loaded = False
        self._session: str | None = None
        targets = self.ask('Target.getTargets')['targetInfos']
        page = next(target for target in targets if target['type'] == 'page')
        self._session = self.ask(
            'Target.attachToTarget', targetId=page['targetId'], flatten=True)['sessionId']
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.ask(f'{domain}.enable')

    def ask(self, method: str, seconds: float = 30.0, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its answer; record events that arrive in the meantime.

        :raises AssertionError: if the browser refuses, ends, or does not answer in time.
        """
        self._number += 1
        message = {'id': self._number, 'method': method, 'params': parameters}
        if self._session is not None:
            message['sessionId'] = self._session
        os.write(self._write, json.dumps(message).encode() + b'\0')
        end = time.monotonic() + seconds
        while True:
            answer = self._receive(end, method)
            if answer.get('id') == self._number:
                assert 'error' not in answer, f'{method}: {answer["error"]}'
                return dict(answer['result'])

    def _receive(self, end: float, what: str) -> dict[str, Any]:
        while b'\0' not in self._pending:
            ready, _, _ = select.select([self._read], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise Late(f'the browser did not answer {what} in time:\n{self.said()}')
            data = os.read(self._read, 1 << 20)
            assert data, f'the browser ended during {what}:\n{self.said()}'
            self._pending += data
        text, _, self._pending = self._pending.partition(b'\0')
        message: dict[str, Any] = json.loads(text)
        self._note(message)
        return message

    def _note(self, message: dict[str, Any]) -> None:
        """Record the errors of the page and the addresses that it requests."""
        kind, said = message.get('method'), message.get('params', {})
        if kind == 'Page.loadEventFired':
            self._loaded = True
        elif kind == 'Network.requestWillBeSent':
            self.requests.append(said['request']['url'])
        elif kind == 'Runtime.exceptionThrown':
            self.console.append(json.dumps(said['exceptionDetails'])[:2000])
        elif kind == 'Runtime.consoleAPICalled' and said['type'] in ('error', 'assert'):
            self.console.append(' '.join(
                str(item.get('value', item.get('description', ''))) for item in said['args']))
        elif kind == 'Log.entryAdded' and said['entry']['level'] == 'error':
            self.console.append(f'{said["entry"]["text"]} {said["entry"].get("url", "")}')

    def open(self, url: str, seconds: float = 60.0) -> None:
        """Open a page in place of the present one, and wait until it is loaded."""
        self._loaded = False
        error = self.ask('Page.navigate', url=url).get('errorText')
        assert not error, f'{url}: {error}'
        end = time.monotonic() + seconds
        while not self._loaded:
            self._receive(end, f'Page.navigate to {url}')

    def picture(self, seconds: float) -> Image.Image:
        """Return a screenshot; this takes as long as the page takes to draw itself."""
        data = self.ask('Page.captureScreenshot', seconds, format='png')['data']
        return Image.open(io.BytesIO(base64.b64decode(data))).convert('RGB')

    def wait_for(
        self, seen: Callable[[Image.Image], bool], seconds: float, what: str,
    ) -> Image.Image:
        """Return the first picture for which `seen` is true.

        :raises AssertionError: with the browser's output, if there is none in time.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            # A page that is still loading may ignore a request for a picture.
            with suppress(Late):
                picture = self.picture(min(_SHOT, max(1.0, end - time.monotonic())))
                picture.save(self.log.with_suffix('.png'))  # to show the reason of a failure
                if seen(picture):
                    return picture
            time.sleep(_PAUSE)
        raise AssertionError(
            f'no {what} in the page after {seconds:g} s:\n{self.console}\n{self.said()}')

    def said(self) -> str:
        """Return the end of the output of the program, without messages about dbus."""
        lines = self.log.read_text(errors='replace').splitlines()
        return '\n'.join(line for line in lines if 'dbus' not in line)[-4000:]

    def close(self) -> None:
        """End the browser with all its processes."""
        with suppress(AssertionError, OSError):
            self.ask('Browser.close', 5.0)
        for fd in (self._write, self._read):
            os.close(fd)
        with suppress(subprocess.TimeoutExpired):
            self._child.wait(5.0)
        with suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)  # including helpers that outlived it
        self._child.wait()
