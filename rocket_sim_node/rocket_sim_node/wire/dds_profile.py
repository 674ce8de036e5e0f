# SPDX-License-Identifier: Apache-2.0
"""Whether an XML profile is one that Fast DDS will take as it stands.

Fast DDS reads its profiles while a participant is made. Of a file with an error in it it takes
nothing at all and prints a line, so that a node runs with other settings than its owner believes.
"""
from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

_NAMESPACES = ('http://www.eprosima.com', 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles')
"""of today's and of older documents; Fast DDS takes either, or none"""
_VARIABLE = re.compile(r'\$\{(\w*)\}')


class ProfileError(ValueError):
    """An XML profile that Fast DDS would not take as a whole."""


def schema_path() -> Path | None:
    """Return the schema of profiles that came with Fast DDS 3; None without one."""
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        path = Path(prefix) / 'share' / 'fastdds' / 'fastdds_profiles.xsd'
        if prefix and path.is_file():
            return path
    return None


def check_profile(path: Path, schema: Path) -> None:
    """Check a profile against the schema of Fast DDS.

    :raises ProfileError: names file, line, what is there and what was expected.
    """
    from lxml import etree

    try:
        content = path.read_bytes()
    except OSError as error:
        raise ProfileError(
            f'{path}: {error.strerror or error}, expected an XML profile of Fast DDS') from error
    try:
        root = etree.fromstring(content, etree.XMLParser(
            resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True))
    except etree.XMLSyntaxError as error:
        raise ProfileError(f'{path}:{error.lineno}: no XML: {error.msg}') from error
    name = etree.QName(root)
    if name.namespace not in (None, *_NAMESPACES):
        raise ProfileError(
            f'{path}:{root.sourceline}: namespace {name.namespace!r}, expected {_NAMESPACES[0]!r}')
    for element in root.iter():
        element.tag = f'{{{_NAMESPACES[0]}}}{etree.QName(element).localname}'
        if element.text:
            element.text = _filled_in(path, element.sourceline, element.text)
    rules = etree.XMLSchema(etree.parse(schema))
    if not rules.validate(root):
        first = rules.error_log[0]
        message = first.message.replace(f'{{{_NAMESPACES[0]}}}', '')
        if 'Expected is' not in message:
            message = f'{message} Expected is what {schema} says'
        raise ProfileError(f'{path}:{first.line}: {message}')
    _check_transports(path, root)


def _filled_in(path: Path, line: int, text: str) -> str:
    """Return a text with the variables of the environment in it, as Fast DDS reads it."""
    for name in _VARIABLE.findall(text):
        if name not in os.environ:
            raise ProfileError(
                f'{path}:{line}: ${{{name}}}, expected a variable of the environment')
    return _VARIABLE.sub(lambda match: os.environ[match[1]], text)


def _check_transports(path: Path, root: Any) -> None:
    """Check what the schema cannot say: the transports of a participant are described."""
    namespaces = {'f': _NAMESPACES[0]}
    described = root.iterfind('.//f:transport_descriptor/f:transport_id', namespaces)
    known = [element.text for element in described]
    for element in root.iterfind('.//f:userTransports/f:transport_id', namespaces):
        if element.text not in known:
            raise ProfileError(
                f'{path}:{element.sourceline}: transport_id {element.text!r}, expected one of the '
                f'transport_descriptors: {", ".join(map(str, known)) or "there are none"}')
