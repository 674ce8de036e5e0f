# SPDX-License-Identifier: Apache-2.0
"""Validation of XML profiles that Fast DDS would otherwise ignore.

Fast DDS reads its profiles while a participant is created. If a file has an error, it ignores the
whole file and prints one line, so the node runs with other settings than the user expects. The
same happens with a file of which ROS 2 uses nothing.
"""
from __future__ import annotations

import ipaddress
import os
import re
from pathlib import Path
from typing import Any

from rocket_sim_node import input_file

_LARGEST = 1_000_000
"""Maximum bytes of a profile."""
_NAMESPACES = ('http://www.eprosima.com', 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles')
"""Namespaces of current and older documents; Fast DDS accepts either, or none."""
_PREFIX = {'f': _NAMESPACES[0]}
_VARIABLE = re.compile(r'\$\{(\w*)\}')
_DEFAULT = 'is_default_profile'
_BY_TOPIC = ('data_writer', 'data_reader')
_BY_DEFAULT = ('participant', 'topic', 'domainparticipant_factory')
"""Profiles that ROS 2 uses by default; it also uses profiles named after a topic."""
_NO_PROFILES = ('log', 'library_settings')
"""Sections outside of profiles that Fast DDS reads."""
_HOST = r'(?=.*[^\W\d])[\w.-]+'
_ADDRESSES: dict[str, tuple[Any, str, str]] = {
    'interfaceWhiteList': (
        ipaddress.ip_address, rf'{_HOST}(:\w+)?', 'an IP address or the name of an interface'),
    'udpv4': (ipaddress.IPv4Address, _HOST, 'an IPv4 address or the name of a host')}
"""Per element: the parser of an address, the pattern of a host name, and both in words."""


class ProfileError(ValueError):
    """An XML profile that Fast DDS would reject, or that has no effect."""


def check_profile(path: Path, schema: Path) -> None:
    """Check a profile against the XML schema of Fast DDS.

    :raises ProfileError: naming file, line, actual and expected value.
    """
    from lxml import etree

    try:
        content = input_file.read_bytes(path, _LARGEST)
    except ValueError as error:
        raise ProfileError(str(error)) from error
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
    current, older = (namespace.encode() for namespace in _NAMESPACES)
    rules = etree.XMLSchema(etree.fromstring(schema.read_bytes().replace(older, current)))
    if not rules.validate(root):
        first = rules.error_log[0]
        message = first.message.replace(f'{{{_NAMESPACES[0]}}}', '')
        if 'Expected is' not in message:
            message = f'{message} Expected is a profile that {schema} accepts'
        raise ProfileError(f'{path}:{first.line}: {message}')
    _check_names(path, root)
    _check_use(path, root)
    _check_transports(path, root)
    _check_addresses(path, root)


def _filled_in(path: Path, line: int, text: str) -> str:
    """Return a text with environment variables expanded as Fast DDS does."""
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
    """Check that names are unique within a kind, which the schema cannot express."""
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
    """Check that ROS 2 uses part of the file, which the schema cannot express."""
    profiles = _profiles(root)
    if any(kind in _BY_TOPIC or (kind in _BY_DEFAULT and element.get(_DEFAULT) == 'true')
           for kind, element in profiles):
        return
    for kind, element in profiles:
        if kind == 'participant':
            raise ProfileError(
                f'{path}:{element.sourceline}: {_DEFAULT} of participant '
                f'{element.get("profile_name")!r} is {element.get(_DEFAULT, "missing")}, expected '
                'true: ROS 2 ignores other participants')
    if next(root.iter(*(f'{{{_NAMESPACES[0]}}}{name}' for name in _NO_PROFILES)), None) is None:
        raise ProfileError(
            f'{path}:{root.sourceline}: no profile that ROS 2 uses, expected a participant with '
            f'{_DEFAULT}="true", a data_writer or a data_reader')


def _check_transports(path: Path, root: Any) -> None:
    """Check that a participant's transports are defined, which the schema cannot express."""
    described = root.iterfind('.//f:transport_descriptor/f:transport_id', _PREFIX)
    known = [element.text for element in described]
    for element in root.iterfind('.//f:userTransports/f:transport_id', _PREFIX):
        if element.text not in known:
            raise ProfileError(
                f'{path}:{element.sourceline}: transport_id {element.text!r}, expected one of the '
                f'transport_descriptors: {", ".join(map(str, known)) or "there are none"}')


def _check_addresses(path: Path, root: Any) -> None:
    """Check that addresses are addresses or valid host names, which the schema cannot express."""
    for place, (read, name, words) in _ADDRESSES.items():
        for element in root.iterfind(f'.//f:{place}/f:address', _PREFIX):
            try:
                read(element.text)
            except ValueError:
                if not re.fullmatch(name, element.text):
                    raise ProfileError(
                        f'{path}:{element.sourceline}: address {element.text!r}, expected {words}'
                    ) from None
