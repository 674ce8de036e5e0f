# SPDX-License-Identifier: Apache-2.0
"""Input files: special and oversized files are refused before they are read."""
from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from rocket_sim_node import input_file
from rocket_sim_node.recording.reader import trajectories


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / 'file'
    path.write_bytes('one\r\ntwö\r\n'.encode())
    assert input_file.read_bytes(path, 11) == path.read_bytes()
    assert input_file.read_text(path, 11) == 'one\ntwö\n'
    path.write_bytes(b'\xff')
    with pytest.raises(ValueError, match='file: damaged'):
        input_file.read_text(path, 10)
    with pytest.raises(FileNotFoundError):
        input_file.read_bytes(tmp_path / 'none', 10)


@pytest.mark.parametrize('kind', ['folder', 'FIFO', 'socket', 'device', 'bytes'])
def test_special_and_oversized_files_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'file'
    if kind == 'folder':
        path.mkdir()
    elif kind == 'FIFO':
        os.mkfifo(path)
    elif kind == 'socket':
        socket.socket(socket.AF_UNIX).bind(str(path))
    elif kind == 'device':
        path.symlink_to('/dev/zero')
    else:
        path.touch()
        os.truncate(path, 2**40)  # a hole: it takes no room on the disk
    for read in (input_file.check, input_file.read_bytes, input_file.read_text):
        with pytest.raises(ValueError, match=f'file: got .*{kind}, expected'):
            read(path, 1000)
    with pytest.raises(ValueError, match=f'file: got .*{kind}, expected'):
        trajectories(path)
