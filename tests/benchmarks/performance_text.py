# SPDX-License-Identifier: Apache-2.0
"""What docs/performance.md says of each part; every number in it comes from the figures."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

Figures = dict[str, Any]


def _batch(rows: dict[str, Figures]) -> tuple[str, Figures]:
    """Return 256 and the row of so many rockets, or those of the largest batch."""
    size = '256' if '256' in rows else max(rows, key=int)
    return size, rows[size]


def _exchange(f: Figures) -> str:
    size, row = _batch(f['exchange'])
    return (
        'One action out and one observation and reward back, for a whole batch, in lock-step, '
        'with a world in which nothing moves. The floor is a TCP ping-pong of the same bytes '
        'between two Python processes. Both are measured twice: where the scheduler puts them, '
        'which is mostly one core for TCP, and with each process on a core of its own, which is '
        'what simulator and agent want when both have work to do. '
        f'With {size} rockets and a core each: {row["dds_apart"]:.0f} us over DDS, '
        f'{row["tcp_apart"]:.0f} us over TCP, {row["ratio_apart"]:.1f} times the floor. '
        f'As scheduled: {row["dds"]:.0f} us and {row["tcp"]:.0f} us, {row["ratio"]:.1f} times; '
        f'DDS as scheduled makes {row["ratio_scheduled_apart"]:.1f} times TCP with a core each. '
        'The nodes do not choose cores, since that would take them from others; '
        '`taskset -c 1 ros2 run …` does it for a node.')


def _budget(f: Figures) -> str:
    return (
        'Where the time of one lock-step step of a training roll-out goes, '
        f'{f["num_envs"]} rockets, one '
        'simulator. Agent and simulator take turns '
        'here; with two simulators or more they work at once (next table), so that only what the '
        'agent does remains. Medians, which need not add up to the whole.')


def _rollouts(f: Figures) -> str:
    rows = f['rollouts']

    def each(value: Callable[[Figures], float]) -> str:
        return ', '.join(f'{value(row):.2f} with {size}' for size, row in rows.items())

    return (
        'Training roll-outs, policy, buffers and snapshots included, over DDS and in one process '
        'without ROS. With two simulators the agent thinks '
        'about one batch while the other moves. What was flown is compared, bit for bit, with the '
        'same flights in process. '
        'Two simulators make, of the speed of one world in process: '
        f'{each(lambda row: row["ratio"]["DDS, 2"])} rockets. That two batches of half the size '
        'are not as fast as one, even without ROS, is part of it (two worlds of one: '
        + each(lambda row: row['steps_per_second']['in process, 2']
               / row['steps_per_second']['in process, 1'])
        + '); of the speed of two worlds in process ("of equals") two simulators make '
        f'{each(lambda row: row["ratio_of_equals"]["DDS, 2"])}. A single simulator that takes '
        'turns with its agent could make '
        f'{each(lambda row: row["tcp_bound"])} if its exchange cost no more than a TCP ping-pong '
        'of the same bytes.')


def _fleet(f: Figures) -> str:
    rows = f['fleet']
    first, last = min(rows, key=int), max(rows, key=int)
    return (
        'What another simulator costs its agent, in processor time of the agent for an exchange: '
        f'{rows[first]["cpu_us"]:.0f} us with {first}, {rows[last]["cpu_us"]:.0f} us with {last} '
        f'({rows[last]["ratio"]:.2f} times). In wall clock an exchange takes '
        f'{rows[first]["wall_us"]:.0f} us with {first}, {rows[last]["wall_us"]:.0f} us with '
        f'{last}, all of them on the cores of this machine.\n\n' + _saturation(f))


def _saturation(f: Figures) -> str:
    """Return what ends first when simulators are many, from the measured costs."""
    wire, think = f['wire_us'], f['inference_us']
    agent = 1e6 / (wire + think)
    network = 1e9 / (8 * f['bytes_per_exchange'])
    simulator = f['physics_us'] + wire
    first = ('the agent, before the cable' if agent < network else 'the cable, before the agent')
    return (
        'How many simulators of 256 rockets can one agent feed on while it rolls out? Its work '
        f'for an exchange is {wire:.0f} us of wire and {think:.0f} us of inference on one core, '
        f'so it takes {agent:,.0f} exchanges/s, {256 * agent:,.0f} rocket steps/s. A simulator '
        f'with a core of its own needs about {simulator:.0f} us for a step, meanwhile the agent '
        f'can serve others: {1 + simulator / (wire + think):.1f} simulators keep it busy. An '
        'exchange is '
        f'{f["bytes_per_exchange"]:,} bytes; 1 Gbit/s carries {network:,.0f} of them a second, '
        f'{network / agent:.1f} times what the agent takes. So what saturates first is {first}. '
        'More simulators than that make sense where a step is dearer than in world `rocket`, or '
        'to go on while some of them restart.')


def _hosts(f: Figures) -> str:
    size, row = _batch(f['hosts'])
    return (
        f'An exchange with a simulator on another host, {size} rockets: '
        f'{row["ratio"]:.2f} times one within the host. The hosts are network namespaces joined '
        f'by a virtual cable, so this is the cost of '
        'the network stack and of acknowledging, not of a real cable.')


def _stepping(f: Figures) -> str:
    rocket, lander = f['ratios']['rocket'], f['ratios']['lunar_lander']
    peer = 'EnvPool' if 'EnvPool' in rocket else 'Gymnasium'
    return (
        "Environment steps per second on one core, random actions, episodes and resets included, "
        "at each one's best batch: `rocket` makes "
        f"{rocket[peer]:.0f} times as many as {peer}'s LunarLander, our `lunar_lander` "
        f"{lander[peer]:.1f} times.")


def _learner(f: Figures) -> str:
    return (
        "A PPO update beside stable-baselines3's with equal networks, minibatches, epochs and "
        "samples; the floor is the bare matrix "
        'products of the same shapes. Losses and weights are compared with an autograd reference '
        'by `tests/unit/ppo_agent_node/ppo/test_update_reference.py`.')


def _result(f: Figures) -> str:
    if 'lunar_lander' not in f:
        return (
            'Wall clock from the start of the processes, with the preset `quick`, to the end of '
            'the evaluation.')
    lander = f['lunar_lander']
    return (
        'Wall clock from the start of the processes until a deterministic evaluation of 100 '
        'episodes passes, side by side in one run on the same cores: ours over DDS in separate '
        'processes, with the preset `quick`, stable-baselines3 with the settings of rl-zoo, and '
        'a tuned PPO in one process on EnvPool. A run ends at the cap, and counts as long as '
        'that: '
        f'{lander["cap"]:.0f} s here. Each evaluates in its own lander; the last column is '
        "the same policy in Gymnasium's.")


def _recorder(f: Figures) -> str:
    return (
        'Speed of simulator and agent with a recorder beside them, in turns with none: '
        + ' and '.join(
            f'{name} {part["ratio"]:.3f} ({part["low"]:.3f} to {part["high"]:.3f})'
            for name, part in f.items())
        + ', mean and 95 % interval.')


def _loss(f: Figures) -> str:
    rows = f['loss']
    return (
        'Steps between two hosts that throw away a share of the packets that arrive. All steps '
        'and the state after the last are compared with those of a world in process: '
        + ('the same, bit for bit. ' if all(row['equal'] for row in rows.values())
           else 'NOT ALL ARE THE SAME. ')
        + 'The 99th percentile of a step is '
        + ', '.join(f'{row["p99"]:.1f} ms with {float(share):.0%} lost'
                    for share, row in rows.items())
        + '. "Its median" is that of stretches of 300 steps, as what else the machine has to do '
        'comes in bursts.')


def _heuristic(f: Figures) -> str:
    return (
        "The pilot that comes with Gymnasium's LunarLander, flown in our `lunar_lander` and in "
        "Gymnasium's: "
        + ' and '.join(
            f'{row["difference"]:+.1f} ({row["difference_interval"][0]:+.1f} to '
            f'{row["difference_interval"][1]:+.1f}) with {row["action"]} actions'
            for row in f['heuristic'])
        + ', difference of the mean returns and 95 % interval. "Published" are EnvPool\'s.')


def _transfer(f: Figures) -> str:
    low, high = f['difference_interval']
    return (
        'A `lunar_lander` policy, of the newest run or else the one that ships, flown unchanged '
        "in Gymnasium's: "
        f'{f["ours"]:.1f} here, {f["gymnasium"]:.1f} there, difference '
        f'{f["difference"]:+.1f} ({low:+.1f} to {high:+.1f}, 95 % interval).')


def _stopping(f: Figures) -> str:
    return 'Seconds from Ctrl-C to the end of the last process, by stage of a training.'


def _key_latency(f: Figures) -> str:
    return (
        "From a key of the keyboard's pilot to the first state that shows it, in real time, where "
        f'a step takes 20 ms: median {f["median_ms"]:.1f} ms.')


SECTIONS: dict[str, tuple[str, Callable[[Figures], str]]] = {
    'exchange': ('A lock-step exchange', _exchange),
    'budget': ('The budget of a step', _budget),
    'rollouts': ('Roll-outs', _rollouts),
    'fleet': ('Many simulators', _fleet),
    'hosts': ('Two hosts', _hosts),
    'loss': ('Two hosts that lose packets', _loss),
    'stepping': ('Stepping a world', _stepping),
    'learner': ('The learner', _learner),
    'result': ('Time to a result', _result),
    'heuristic': ("Gymnasium's pilot in our lander", _heuristic),
    'transfer': ("Our policy in Gymnasium's lander", _transfer),
    'recorder': ('The recorder', _recorder),
    'stopping': ('Stopping', _stopping),
    'key_latency': ('From key to state', _key_latency),
}
"""Title and text of each part, in the order of the page."""
