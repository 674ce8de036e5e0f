# SPDX-License-Identifier: Apache-2.0
"""Whether an XML profile is one that Fast DDS will take as it stands.

Fast DDS reads its profiles while a participant is made. Of a file with an error in it it takes
nothing at all and prints a line, so that a node runs with other settings than its owner believes.
So does one with a file of which ROS 2 uses nothing.
"""
from __future__ import annotations

import ipaddress
import os
import re
from pathlib import Path
from typing import Any

_NAMESPACES = ('http://www.eprosima.com', 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles')
"""of today's and of older documents; Fast DDS takes either, or none"""
_PREFIX = {'f': _NAMESPACES[0]}
_VARIABLE = re.compile(r'\$\{(\w*)\}')
_DEFAULT = 'is_default_profile'
_BY_TOPIC = ('data_writer', 'data_reader')
_BY_DEFAULT = ('participant', 'topic', 'domainparticipant_factory')
"""profiles that ROS 2 uses: those named like a topic, too, and those that are the default"""
_NO_PROFILES = ('log', 'library_settings')
"""what Fast DDS heeds beside profiles"""
_HOST = r'(?=.*[^\W\d])[\w.-]+'
_ADDRESSES: dict[str, tuple[Any, str, str]] = {
    'interfaceWhiteList': (
        ipaddress.ip_address, rf'{_HOST}(:\w+)?', 'an IP address or the name of an interface'),
    'udpv4': (ipaddress.IPv4Address, _HOST, 'an IPv4 address or the name of a host')}
"""by where they stand: what reads an address, what a name looks like, and both in words"""


class ProfileError(ValueError):
    """An XML profile that Fast DDS would not take as a whole, or that changes nothing."""


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
    _check_names(path, root)
    _check_use(path, root)
    _check_transports(path, root)
    _check_addresses(path, root)


def _filled_in(path: Path, line: int, text: str) -> str:
    """Return a text with the variables of the environment in it, as Fast DDS reads it."""
    for name in _VARIABLE.findall(text):
        if name not in os.environ:
            raise ProfileError(
                f'{path}:{line}: ${{{name}}}, expected a variable of the environment')
    return _VARIABLE.sub(lambda match: os.environ[match[1]], text)


def _profiles(root: Any) -> list[tuple[str, Any]]:
    """Return all profiles, each with its kind."""
    elements = root.xpath('//f:profiles/*[@profile_name]', namespaces=_PREFIX)
    return [(element.tag.partition('}')[2], element) for element in elements]


def _check_names(path: Path, root: Any) -> None:
    """Check what the schema cannot say: of a kind each has a name of its own."""
    named = [(kind, element.get('profile_name'), element) for kind, element in _profiles(root)]
    for element in root.iterfind('.//f:transport_descriptor/f:transport_id', _PREFIX):
        named.append(('transport_descriptor', element.text, element))
    seen: dict[tuple[str, str], int] = {}
    for kind, name, element in named:
        if (kind, name) in seen:
            raise ProfileError(
                f'{path}:{element.sourceline}: {kind} {name!r}, expected another name: there is '
                f'one in line {seen[kind, name]}')
        seen[kind, name] = element.sourceline


def _check_use(path: Path, root: Any) -> None:
    """Check what the schema cannot say: ROS 2 uses something of it."""
    profiles = _profiles(root)
    if any(kind in _BY_TOPIC or (kind in _BY_DEFAULT and element.get(_DEFAULT) == 'true')
           for kind, element in profiles):
        return
    for kind, element in profiles:
        if kind == 'participant':
            raise ProfileError(
                f'{path}:{element.sourceline}: {_DEFAULT} of participant '
                f'{element.get("profile_name")!r} is {element.get(_DEFAULT, "missing")}, expected '
                'true: ROS 2 uses no other')
    if next(root.iter(*(f'{{{_NAMESPACES[0]}}}{name}' for name in _NO_PROFILES)), None) is None:
        raise ProfileError(
            f'{path}:{root.sourceline}: no profile that ROS 2 uses, expected a participant with '
            f'{_DEFAULT}="true", a data_writer or a data_reader')


def _check_transports(path: Path, root: Any) -> None:
    """Check what the schema cannot say: the transports of a participant are described."""
    described = root.iterfind('.//f:transport_descriptor/f:transport_id', _PREFIX)
    known = [element.text for element in described]
    for element in root.iterfind('.//f:userTransports/f:transport_id', _PREFIX):
        if element.text not in known:
            raise ProfileError(
                f'{path}:{element.sourceline}: transport_id {element.text!r}, expected one of the '
                f'transport_descriptors: {", ".join(map(str, known)) or "there are none"}')


def _check_addresses(path: Path, root: Any) -> None:
    """Check what the schema cannot say: an address is one, or may be a name."""
    for place, (read, name, words) in _ADDRESSES.items():
        for element in root.iterfind(f'.//f:{place}/f:address', _PREFIX):
            try:
                read(element.text)
            except ValueError:
                if not re.fullmatch(name, element.text):
                    raise ProfileError(
                        f'{path}:{element.sourceline}: address {element.text!r}, expected {words}'
                    ) from None
