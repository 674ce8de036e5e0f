# SPDX-License-Identifier: Apache-2.0
"""Definitions of messages: the text that a bag stores, and their type hashes (REP 2016).

Both come from the share folders of the installed packages of interfaces.
"""
from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

PRIMITIVES = {
    'bool': '?', 'byte': 'u1', 'char': 'u1', 'int8': 'i1', 'uint8': 'u1', 'int16': 'i2',
    'uint16': 'u2', 'int32': 'i4', 'uint32': 'u4', 'int64': 'i8', 'uint64': 'u8',
    'float32': 'f4', 'float64': 'f8'}
"""NumPy type codes of the numbers that a message may have."""
TEXTS = ('string', 'wstring')
BORDER = '=' * 80
"""Line before each definition but the first."""
_FIELD = re.compile(r'^([A-Za-z]\w*(?:/\w+)?)(?:<=\d+)?(\[[^\]]*\])?\s+(\w+)(\s*=)?')


def fields(text: str) -> list[tuple[str, str, str]]:
    """Return type, array suffix (empty, [], [n] or [<=n]) and name of the fields of a definition.

    Constants are omitted.
    """
    found = []
    for line in text.splitlines():
        match = _FIELD.match(line.partition('#')[0].strip())
        if match and not match.group(4):
            found.append((match.group(1), match.group(2) or '', match.group(3)))
    return found


def full_name(kind: str, package: str) -> str:
    """Return the type of a field as package/Name, for one in a message of `package`."""
    return kind if '/' in kind else f'{package}/{kind}'


def _share(package: str) -> Path:
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        folder = Path(prefix) / 'share' / package
        if folder.is_dir():
            return folder
    raise ValueError(f'package {package!r} is not installed')


def _path(type_name: str, suffix: str) -> Path:
    package, _, name = type_name.partition('/msg/')
    path = _share(package) / 'msg' / f'{name}.{suffix}'
    if not name or not path.is_file():
        raise ValueError(f'message {type_name!r} is not known: there is no {path}')
    return path


def _installed(name: str) -> str:
    package, _, kind = name.partition('/')
    return _path(f'{package}/msg/{kind}', 'msg').read_text('utf-8')


def definition(type_name: str, text_of: Callable[[str], str] = _installed) -> str:
    """Return the definition of a message followed by those of the messages in it (ros2msg).

    :param type_name: such as nav_msgs/msg/Odometry.
    :param text_of: returns the text of one definition by its name, package/Name.
    :raises ValueError: when one is not installed.
    """
    first = type_name.replace('/msg/', '/')
    known = {first: text_of(first)}
    todo = [first]
    while todo:
        name = todo.pop(0)
        for kind, _, _ in fields(known[name]):
            if kind in PRIMITIVES or kind in TEXTS:
                continue
            inner = full_name(kind, name.partition('/')[0])
            if inner not in known:
                known[inner] = text_of(inner)
                todo.append(inner)
    parts = [known.pop(first).rstrip('\n')]
    parts += [f'{BORDER}\nMSG: {name}\n{text.rstrip(chr(10))}' for name, text in known.items()]
    return '\n'.join(parts) + '\n'


def type_hash(type_name: str) -> str:
    """Return the hash of an installed message, as `ros2 topic info -v` prints it.

    :raises ValueError: when it is not installed, or older than such hashes.
    """
    found = json.loads(_path(type_name, 'json').read_text('utf-8')).get('type_hashes', [])
    for one in found:
        if one['type_name'] == type_name:
            return str(one['hash_string'])
    raise ValueError(f'message {type_name!r} has no type hash')
