# SPDX-License-Identifier: Apache-2.0
"""The page of nodes, topics, services and actions.

The security policy says which node uses which name; a test compares it with the running nodes. The
types and the quality of service come from the code that creates publishers, subscriptions and
services, and the meaning from the comments of the interfaces.
"""
from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from ppo_agent_node.config import training_config
from ppo_agent_node.nodes.agent import inference
from ppo_agent_node.nodes.agent import modes
from ppo_agent_node.nodes.agent import training
from ppo_agent_node.nodes.flights import connection
from reference_pages.parameters import rows
from rocket_sim_node import worlds
from rocket_sim_node.nodes import bag_recorder
from rocket_sim_node.nodes import rerun_recorder
from rocket_sim_node.nodes import ros_bridge
from rocket_sim_node.nodes import simulation
from rocket_sim_node.nodes import simulation_services
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import describe
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher

ROOT = Path(__file__).parents[2]
PACKAGES = ('rocket_sim_node', 'ppo_agent_node')
_MEANING = {
    '/diagnostics': ' '.join(str(DiagnosticsPublisher.__doc__).split()),
    'rocket_*/odom': 'Pose in frame `world`, twist in frame `rocket_*/base_link`.',
    'rocket_*/pose': 'Pose in frame `world`.',
    'rocket_*/imu': 'Specific force, mean over the step, and rates in the body frame; without '
                    'noise. Where the force is not known, its first covariance is -1.',
    'rocket_*/joint_states': 'Joint `throttle`: position 0 to 1, effort the thrust, N. In '
                             '`lunar_lander` also the legs, rad outwards.',
    'rocket_*/wrench': 'Force of the engines, N, and torque of the attitude control (in '
                       '`lunar_lander`, of the side engines), N m, in the body frame.',
    'rocket_*/wind': 'Side acceleration and gusts, m/s², in frame `world`; a steady wind acts '
                     'through the drag. In `lunar_lander`, the acceleration due to wind.',
    'rocket_*/conditions': 'Values drawn for the episode, by name.',
    'rocket_*/markers': 'Flame, path, wind, label and, in `lunar_lander`, the ground.',
    'robot_description': 'Model of the vehicle as URDF, equal for all rockets.',
    'markers': 'Pad, the circle within which a landing counts, and ends of episodes.',
    '/tf': 'From `world` to `rocket_*/base_link`, and from there to moving links.',
    '/clock': 'Simulated time, if parameter `clock` is set.',
}
_ANY = '/*'
"""Topics that bag_recorder reads."""
_DEPRECATED = 'reset', 'snapshot', 'restore', 'release'
"""Names of services of before 1.0."""
_OF_ROS = (
    '/parameter_events', '/rosout', '~/*', '~/simulate_steps/_action/feedback',
    '~/simulate_steps/_action/status', *(
        f'{below}{name}/_service_event' for name in _DEPRECATED for below in ('', '~/')))
"""Names that every node, service with introspection or action has; the page only mentions readers
of /rosout."""
_NEEDED_MOST = {
    '`simulator`': (
        'world', 'num_envs', 'seed', 'mode', 'level', 'conditions', 'observation',
        'realtime_factor', 'action_timeout', 'agent_lease', 'state_rows', 'state_batch'),
    '`rerun_recorder`': (
        'output', 'connect', 'serve_web', 'web_port', 'web_host', 'rows', 'every_nth_episode',
        'crashes', 'max_steps'),
    '`bag_recorder`': ('output', 'topics', 'compression'),
    '`ros_bridge`': ('rows', 'max_rate', 'clock', 'frame_prefix'),
    '`ppo_agent`, mode `train`': (
        'mode', 'run_dir', 'resume', 'preset', 'simulators', 'num_groups', 'device', 'threads',
        'resend_after', 'patience', 'acknowledge'),
    '`ppo_agent`, mode `infer`': ('policy', 'level', 'episodes', 'device')}
_HEAD = """# Nodes, topics, services and actions

All names are relative: `--ros-args -r __ns:=/sim_0` moves a node into a namespace. The exceptions
are `/diagnostics`, `/tf` and `/clock`, as is usual in ROS.
[The protocol](../explanation/lock-step.md) explains how agent and simulator use them.

![The nodes and the topics between them](../images/nodes.svg)

## Topics

"""
_ACKNOWLEDGE = """
Writers of `action`, `observation` and `reward` offer reliable delivery. A reader's parameter
`acknowledge` decides whether it acknowledges messages: with `auto` it does so only if peers beyond
this machine may be discovered, if you have configured Fast DDS yourself, or if observations are
large for the receive buffer ([rule 10](../explanation/lock-step.md#rules)).

## Services

"""
_SNAPSHOT = """
These services are below the simulator's own name (`~/reset` …). For a simulator with another name,
remap all four in the agent: `--ros-args -r simulator/reset:=my_simulator/reset` …, with full names
(`/sim_1/simulator/reset`) if the simulator is in another namespace than the agent.

The names from before 1.0, `reset`, `snapshot`, `restore` and `release`, still answer. They are
deprecated and will be removed in 2.0; the first call is logged as a warning.

[Why a snapshot clears hidden state](../explanation/pymunk-batch.md) in worlds with contact.

### Services of simulation_interfaces

A simulator also answers the services of the standard, below its own name. A page of its own
describes [their behaviour](../how-to/simulation-interfaces.md).

"""
_ACTIONS = """
## Actions

"""
_SERVED = """
`action_server` executes one goal at a time. It starts the nodes of the command of the same name
in the namespace of the action, for instance `/train/simulator`, and subscribes to their topics.
[How to use the actions](../how-to/use-actions.md).

"""
_ROSOUT = """In a terminal, `ppo_agent` and `watch` also subscribe to `/rosout`, to show the
warnings of other nodes.

## Most important parameters

[All parameters](parameters.md) are read-only after start.
"""
_STEPS = """
| `simulator/simulate_steps` | `simulation_interfaces/action/SimulateSteps` \
| Simulates a number of steps ([details](../how-to/simulation-interfaces.md)). |
"""
_INTERFACES = """## Messages, services and actions in full

This is the output of `ros2 interface show`, for instance of `ros2 interface show
rocket_msgs/msg/World`.
"""


def text() -> str:
    """Return the page."""
    interfaces = {
        path.stem: path for kind in ('action', 'msg', 'srv')
        for path in sorted((ROOT / 'rocket_msgs' / kind).glob(f'*.{kind}'))}
    used = _used()
    known, qualities = _created(interfaces)
    actions = _names(used, ('execute',))
    topics = [
        name for name in _names(used, ('subscribe', 'publish'))
        if name != _ANY and name.partition('/')[0] not in actions]
    services = _names(used, ('reply', 'request'))
    lines = ['| name | type | quality of service | carries |', '| --- | --- | --- | --- |']
    lines += [
        f'| `{name}` | {_type(known[_said(name)])} | {_quality(qualities[_said(name)])} '
        f'| {_MEANING.get(name) or _carries(interfaces[known[name].rpartition("/")[2]])} |'
        for name in topics]
    offered = ['| name | type | does |', '| --- | --- | --- |']
    offered += [
        f'| `{name}` | {_type(known[name])} '
        f'| {_comment(interfaces[known[name].rpartition("/")[2]])} |' for name in services]
    offered += [_SNAPSHOT.rstrip('\n'), '', *_standard()]
    executed = ['| name | type | does |', '| --- | --- | --- |']
    executed += [
        f'| `{name}` | {_type(f"rocket_msgs/action/{name.title()}")} '
        f'| {_comment(interfaces[name.title()])} |' for name in actions]
    return '\n'.join([
        _HEAD + '\n'.join(lines), _ACKNOWLEDGE + '\n'.join(offered),
        _ACTIONS + '\n'.join(executed) + _STEPS.rstrip('\n'), _SERVED, *_nodes(used),
        _ROSOUT, *_parameters(), _INTERFACES, *map(_interface, interfaces.values())])


def _used() -> dict[str, dict[str, tuple[str, ...]]]:
    """Return by node what it does (publish, reply, execute …), and to which names."""
    policy = ElementTree.parse(ROOT / 'launch_scripts' / 'security' / 'hoverslam.policy.xml')
    return {
        profile.attrib['node']: {
            does: tuple(
                str(item.text) for item in group if item.text not in (*_OF_ROS, *_DEPRECATED))
            for group in profile for does in group.attrib if does != 'ns'}
        for profile in policy.iter('profile') if profile.attrib['ns'] == '/'}


def _said(name: str) -> str:
    """Return a topic's name as the code spells it: with what follows the number of a rocket."""
    return name.removeprefix('rocket_*')


def _names(used: dict[str, dict[str, tuple[str, ...]]], kinds: Iterable[str]) -> list[str]:
    """Return the names of one kind, in the order in which nodes use them first."""
    return list(dict.fromkeys(
        name for does in used.values() for kind in kinds for name in does.get(kind, ())))


def _created(interfaces: Iterable[str]) -> tuple[dict[str, str], dict[str, QoSProfile]]:
    """Return the type of each topic and service, and the quality of service of each topic.

    Each is created from a call or a tuple that has the type, the name and, for topics, the
    profile, such as `(msg.World, 'world', qos.WORLD)`.
    """
    types: dict[str, str] = {}
    qualities: dict[str, QoSProfile] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package / package).rglob('*.py')):
            tree = ast.parse(path.read_text('utf-8'))
            foreign = {
                alias.name: f'{node.module}.{alias.name}'.replace('.', '/')
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom) and str(node.module).endswith('_msgs.msg')
                for alias in node.names}
            for node in ast.walk(tree):
                parts = node.args if isinstance(node, ast.Call) else (
                    node.elts if isinstance(node, ast.Tuple) else [])
                words = [_word(part) for part in parts]
                names = [word[1:] for word in words if word.startswith("'")]
                kinds = [word.rpartition('.')[2] for word in words]
                for kind in kinds:
                    if names and (kind in interfaces or kind in foreign):
                        types.setdefault(names[0], foreign.get(kind) or (
                            f'rocket_msgs/{"srv" if f"srv.{kind}" in words else "msg"}/{kind}'))
                        for word in words:
                            if re.fullmatch(r'qos\.[A-Z]+', word):
                                qualities[names[0]] = getattr(qos, word[4:])
    return types, qualities


def _word(part: ast.expr) -> str:
    """Return a dotted name, a text with a quote before it, or nothing."""
    if isinstance(part, ast.JoinedStr):
        part = part.values[-1]
    if isinstance(part, ast.Constant) and isinstance(part.value, str):
        return f"'{part.value}"
    return ast.unparse(part) if isinstance(part, ast.Attribute | ast.Name) else ''


def _quality(profile: QoSProfile) -> str:
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    late = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return (f'{"reliable" if reliable else "best effort"}, '
            f'{"transient local" if late else "volatile"}, {profile.depth}')


def _comment(path: Path) -> str:
    """Return the comment at the top of an interface."""
    head = path.read_text('utf-8').partition('\n')[2].partition('\n\n')[0]
    return ' '.join(
        line.removeprefix('#').strip() for line in head.splitlines() if line.startswith('#'))


def _carries(path: Path) -> str:
    """Return two sentences of the comment of a message, without the name of its topic."""
    said = '. '.join(_comment(path).split('. ')[:2]).removesuffix('.') + '.'
    return re.sub(r', (latched )?on `\w+`', '', said)


def _standard() -> Iterable[str]:
    """Yield a table of the services of simulation_interfaces."""
    vendored = ROOT / 'ros_ws' / 'vendor' / 'simulation_interfaces' / 'srv'
    yield '| name | type | supported |'
    yield '| --- | --- | --- |'
    for name in sorted(path.stem for path in vendored.glob('*.srv')):
        answer = (
            'no: answers `RESULT_FEATURE_UNSUPPORTED`'
            if name in simulation_services.UNSUPPORTED else 'yes')
        yield (f'| `simulator/{simulation_services.service_name(name)}` '
               f'| `simulation_interfaces/srv/{name}` | {answer} |')


def _nodes(used: dict[str, dict[str, tuple[str, ...]]]) -> Iterable[str]:
    """Yield a table of nodes for each package."""
    for package in PACKAGES:
        setup = (ROOT / package / 'setup.py').read_text('utf-8')
        yield f'## Nodes of `{package}`\n'
        yield '| node | publishes | subscribes | offers | calls |\n| --- | --- | --- | --- | --- |'
        for node in re.findall(r"'(\w+) = \w+\.entry_points:", setup):
            cells = [
                ', '.join(f'`{name}`' for name in used[node].get(does, ()))
                for does in ('publish', 'subscribe', 'reply', 'request')]
            if actions := used[node].get('execute'):
                named = ', '.join(f'`{name}`' for name in actions)
                cells[2] = ', '.join(filter(None, (cells[2], f'actions {named}')))
            if node == 'simulator':
                page = '../how-to/simulation-interfaces.md'
                cells[2] += (
                    ', action `simulator/simulate_steps`, '
                    f'[services of simulation_interfaces]({page})')
            yield f'| `{node}` | {" | ".join(cells)} |'
        yield ''


def _type(name: str) -> str:
    """Return a type, with a link to its text if it is ours."""
    ours = name.startswith('rocket_msgs/')
    return f'[`{name}`](#{name.rpartition("/")[2].lower()})' if ours else f'`{name}`'


def _parameters() -> Iterable[str]:
    """Yield a table of the parameters that are needed most for some nodes."""
    known: dict[str, tuple[SettingInfo, ...]] = {
        '`simulator`': (
            *worlds.settings(worlds.names()[0]), *describe(simulation.SimulatorParameters),
            *describe(worlds.SteppingSettings)),
        '`rerun_recorder`': (*describe(rerun_recorder.Destinations), *describe(RecordingFilter)),
        '`bag_recorder`': describe(bag_recorder.BagParameters),
        '`ros_bridge`': describe(ros_bridge.BridgeParameters),
        '`ppo_agent`, mode `train`': (
            *describe(connection.ConnectionParameters), *training_config.describe(),
            *describe(training.TrainingParameters), *describe(modes.AgentParameters)),
        '`ppo_agent`, mode `infer`': describe(inference.InferenceParameters)}
    for node, names in _NEEDED_MOST.items():
        found = {info.name: info for info in known[node]}
        yield f'### {node}\n'
        yield rows(found[name] for name in names)


def _interface(path: Path) -> str:
    """Return a heading and the text of an interface."""
    shown = path.read_text('utf-8').partition('\n')[2].strip('\n')
    return f'### {path.stem}\n\n```text\n{shown}\n```\n'
