# SPDX-License-Identifier: Apache-2.0
"""The text of docs/results/performance.md; every number in it comes from the figures."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

Figures = dict[str, Any]


def batch(rows: dict[str, Figures]) -> tuple[str, Figures]:
    """Return the batch size 256 and its row, or the largest batch size and its row."""
    size = '256' if '256' in rows else max(rows, key=int)
    return size, rows[size]


def _exchange(f: Figures) -> str:
    size, row = batch(f['exchange'])
    return (
        'In one exchange, the agent sends an action and the simulator returns an observation and '
        'a reward, for a whole batch in lock-step. The world of this benchmark does no physics. '
        'The floor is a TCP ping-pong of the same bytes between two Python processes. Both are '
        'measured twice: on the cores that the scheduler chooses, which for TCP is often a '
        'single one, and with each process on its own core, which suits a simulator and an agent '
        'that both have work to do. '
        f'With {size} rockets and a core each, DDS takes {row["dds_apart"]:.0f} us and TCP '
        f'{row["tcp_apart"]:.0f} us: {row["ratio_apart"]:.1f} times the floor. '
        f'As scheduled they take {row["dds"]:.0f} us and {row["tcp"]:.0f} us: '
        f'{row["ratio"]:.1f} times. DDS as scheduled takes '
        f'{row["ratio_scheduled_apart"]:.1f} times as long as TCP with a core each. '
        'The nodes do not pin themselves to cores, because other programs need the cores as '
        'well. '
        '`taskset -c 1 ros2 run …` pins a node to a core.')


def _budget(f: Figures) -> str:
    return (
        'This section shows where the time of one lock-step step of a training roll-out is spent, '
        'with '
        f'{f["num_envs"]} rockets and one simulator. Agent and simulator take turns here, except '
        'that the agent checks and records the results of a step while the simulator takes the '
        'next one. With two simulators or more both work at the same time (next table), and only '
        'the share of the agent remains. All figures are medians, so they need not add up to the '
        'whole.')


def _rollouts(f: Figures) -> str:
    rows = f['rollouts']

    def each(value: Callable[[Figures], float]) -> str:
        return ', '.join(f'{value(row):.2f} with {size}' for size, row in rows.items())

    return (
        'This section compares training roll-outs with policy, buffers and snapshots over DDS '
        'and in one process without ROS. With two simulators the agent computes the actions of '
        'one batch while the other batch moves. Every roll-out over DDS is '
        'compared, bit for bit, with the same roll-out in process.\n\n'
        'Two simulators reach this share of the speed of one world in process: '
        f'{each(lambda row: row["ratio"]["DDS, 2"])} rockets. Part of the loss comes from '
        'splitting the batch: two worlds of half the size are slower than one even without ROS ('
        + each(lambda row: row['steps_per_second']['in process, 2']
               / row['steps_per_second']['in process, 1'])
        + '). Compared with two worlds in process ("of equals"), two simulators reach '
        f'{each(lambda row: row["ratio_of_equals"]["DDS, 2"])}.\n\n'
        'One simulator and its agent, each pinned to a core of its own (`taskset -c 1 ros2 run '
        '…`), reach this share of the speed in process: '
        f'{each(lambda row: row["ratio_apart"])}. From a step in process and an exchange over '
        f'DDS, each measured alone, one would expect {each(lambda row: row["dds_parts"])}; with a '
        'TCP ping-pong of the same bytes as the exchange, which is the floor, '
        f'{each(lambda row: row["tcp_parts"])}. The parts take longer in a roll-out than alone, '
        'as [inference](#the-budget-of-a-step) shows.')


def _fleet(f: Figures) -> str:
    rows = f['fleet']
    first, last = min(rows, key=int), max(rows, key=int)
    return (
        'This section shows what each further simulator costs its agent. Processor time of the '
        'agent for an '
        f'exchange: {rows[first]["cpu_us"]:.0f} us with {first}, {rows[last]["cpu_us"]:.0f} us '
        f'with {last} ({rows[last]["ratio"]:.2f} times). A large part of the former is polling, '
        'with which the agent waits for a single simulator. Wall clock of an exchange: '
        f'{rows[first]["wall_us"]:.0f} us with {first}, {rows[last]["wall_us"]:.0f} us with '
        f'{last}. All simulators share the cores of this machine.\n\n' + _saturation(f))


def _saturation(f: Figures) -> str:
    """Return a text on what many simulators saturate first, from the measured costs."""
    wire, think = f['wire_us'], f['inference_us']
    agent = 1e6 / (wire + think)
    network = 1e9 / (8 * f['bytes_per_exchange'])
    simulator = f['physics_us'] + wire
    busy = 1 + simulator / (wire + think)
    first = 'the agent' if agent < network else 'the link'
    return (
        'How many simulators of 256 rockets can one agent serve during a roll-out? An exchange '
        f'costs the agent {wire:.0f} us for the wire and {think:.0f} us for inference on one '
        f'core, so it serves {agent:,.0f} exchanges/s, which is {256 * agent:,.0f} rocket '
        f'steps/s. A simulator with a core of its own needs about {simulator:.0f} us for a step. '
        'The agent can serve others meanwhile: '
        f'{busy:.1f} simulators keep it busy. As an extreme example, 10 000 of '
        f'them would need {1e4 / busy:,.0f} agents, '
        'as [ranks of one run](#several-learners). An exchange is '
        f'{f["bytes_per_exchange"]:,} bytes. A link of 1 Gbit/s carries '
        f'{network:,.0f} of them a second, '
        f'{network / agent:.1f} times as many as the agent serves, so {first} saturates first. '
        'More simulators are useful if a step costs more than in world `rocket`, or if training '
        'should continue while some of them restart.')


def _hosts(f: Figures) -> str:
    size, row = batch(f['hosts'])
    return (
        f'An exchange of {size} rockets with a simulator on another host takes '
        f'{row["ratio"]:.2f} times as long as one within the host. The hosts are network '
        'namespaces joined by a virtual cable. This measures the network stack and '
        'the acknowledgements, not a real cable.')


def _ranks(f: Figures) -> str:
    f = f['ranks']
    rows = {name: row for name, row in f['rows'].items() if name != 'one rank'}
    here = rows['two ranks']
    errors = [row['model'] / row['iteration'] - 1 for row in rows.values()]
    speeds = [f'{here["speed_up"]:.2f} times as fast as one on this machine', *(
        f'{row["speed_up"]:.2f} times over a network with a delay of {name.split(", ")[1]}'
        for name, row in rows.items() if ', ' in name)]
    return (
        'Two ranks train one run, each with its own worlds, without ROS '
        '([how](../how-to/fleets-and-hosts.md#several-learners)). They are '
        f'{", ".join(speeds)}. Each '
        f'iteration has {here["collectives"]:.0f} exchanges with all ranks, most of them sums of '
        'gradients, one after the other. '
        'A model adds their time to that of flight and update: it differs from the measured '
        f'iterations by {100 * min(errors):+.0f} to {100 * max(errors):+.0f} %. By the model, the '
        'share of the time in which ranks work falls with their number; the last column of the '
        'second table is the smallest number of ranks at which it is less than half. '
        'gloo sums in a ring, nccl in a tree. More than two ranks '
        'were not measured. 10 000 simulators need thousands of ranks '
        '([how many one agent serves](#many-simulators)), so most of their time would be spent '
        'waiting. Only fewer sums of gradients for each sample change that: larger minibatches '
        'and fewer epochs.')


def _stepping(f: Figures) -> str:
    rocket, lander = f['ratios']['rocket'], f['ratios']['lunar_lander']
    peer = 'EnvPool' if 'EnvPool' in rocket else 'Gymnasium'
    return (
        'Environment steps per second on one core, with random actions, episodes and resets '
        'included, at the best batch size of each side. Our `lunar_lander` has the task and the '
        'reward of the peers, with fewer iterations of the solver '
        '([differences](../explanation/physics-and-reward.md#lunar_lander)), and makes '
        f"{lander[peer]:.1f} times as many steps as {peer}'s LunarLander. `rocket` has other "
        'physics, without joints or contacts, so its factor '
        f'({rocket[peer]:.0f}) compares two different tasks.' + _stepping_limits(f))


def _stepping_limits(f: Figures) -> str:
    limits = f.get('limits')
    if limits is None or limits['sizes'][:1] != [1]:
        return ''
    step, operation = limits['step'], limits['operation']
    own = step['lunar_lander'][0] * (1 - limits['pymunk_share'][0])
    return (
        f' A step of one lander takes {step["lunar_lander"][0]:.0f} us, of which pymunk\'s own '
        f'calls take {step["lunar_lander"][0] - own:.0f} us. The remaining {own:.0f} us, and the '
        f'{step["rocket"][0]:.0f} us of a step of one rocket, '
        'are mostly the overhead of calls into NumPy, which grows more slowly than the batch: '
        f'the smallest operation takes {operation:.2f} us, so these times are '
        f'those of {own / operation:.0f} and {step["rocket"][0] / operation:.0f} such operations. '
        'Only fewer calls, such as a compiled step, would make small batches faster.'
        + (f" EnvPool's whole step takes {step['EnvPool'][0]:.0f} us."
           if 'EnvPool' in step else ''))


def _threads(f: Figures) -> str:
    rows = f['threads']
    gains = ', '.join(f'{row["gain"]:.2f} with {row["size"]} of `{row["world"]}`' for row in rows)
    return (
        'The parameter `step_threads` of a simulator, of `worlds.make` and of '
        '`gymnasium.make_vec` distributes the pymunk Spaces of a `lunar_lander` world over '
        "threads, because pymunk's solver releases Python's global lock. Results are the same, "
        'bit for bit, for any number of threads '
        '(`tests/unit/rocket_sim_node/worlds/lunar/test_lunar_lander.py`). `rocket` does not use '
        'threads; its rows show the most that threads could gain there, with separate smaller '
        'worlds that are stepped by one thread each. '
        f'Speed-up of {rows[0]["threads"]} threads over one, as the ratio of the 5 % quantiles of '
        f'the step time: {gains}. Threads are useful if cores are idle while the simulator steps; '
        'the agent and [further simulators](#many-simulators) need cores as well.')


def _learner(f: Figures) -> str:
    return (
        'This section compares a PPO update with that of stable-baselines3, with equal networks, '
        'minibatches, epochs and samples. The floor is the bare matrix products of the same '
        'shapes. Where two threads are slower than one, as with small networks, compare the best '
        'rows of both. '
        '`tests/unit/ppo_agent_node/ppo/test_update_reference.py` compares losses and weights '
        'with an autograd reference.')


def _result(f: Figures) -> str:
    lander = f['lunar_lander']
    return (
        'Wall clock from the start of the processes until a deterministic evaluation of 100 '
        'episodes or more passes, measured in one run on the same cores. Ours runs over DDS in '
        'separate processes, with two presets: `quick` imitates a scripted pilot, and '
        '`from_scratch` is PPO alone. The peers are PPO alone: that of stable-baselines3 with the '
        'settings of rl-baselines3-zoo, and a tuned one in one process on EnvPool. A run that '
        f'reaches the cap, {lander["cap"]:.0f} s, counts as that long. Each program '
        'evaluates in its own lander. The last column shows the return of the same policy in '
        "Gymnasium's lander. The lines with medians show how many seeds each program ran; these "
        'numbers can differ. The settings of our presets were chosen on seeds 1 to 10, 101 to 106 '
        'and 111 to 118, and `from_scratch` was changed once more after a measurement of seeds 31 '
        'to 35; the settings of the PPO on EnvPool were chosen on seeds 1 to 10, 101 to 106 and '
        '111 to 117. This benchmark refuses all of these seeds. Ours and the PPO on EnvPool are '
        'evaluated only once many of their training episodes land; stable-baselines3 is evaluated '
        'after every 32 768 steps.')


def _rocket_result(f: Figures) -> str:
    return (
        'Wall clock from the start of the processes, with the preset `quick` and two simulators, '
        'to the end of the evaluation.')


def _recorder(f: Figures) -> str:
    bags = [part for name, part in f.items() if name.startswith('bag_recorder')]
    bag = '' if not bags else (
        f' `bag_recorder` recorded {sum(part["recorded"] for part in bags):,} messages and missed '
        f'{sum(part["missed"] for part in bags):,}.')
    return (
        'Speed of simulator and agent beside a node that listens, as a share of the speed without '
        'it, measured alternately: '
        + '; '.join(
            f'{name} {part["ratio"]:.3f} ({part["low"]:.3f} to {part["high"]:.3f})'
            for name, part in f.items())
        + f', mean and 95 % interval.{bag}')


def _loss(f: Figures) -> str:
    rows = f['loss']
    return (
        'Two hosts exchange steps and drop a share of the incoming packets. All steps and the '
        'final state are compared with those of a world in process: '
        + ('they are the same, bit for bit. ' if all(row['equal'] for row in rows.values())
           else 'NOT ALL ARE THE SAME. ')
        + 'The 99th percentile of a step is '
        + ', '.join(f'{row["p99"]:.1f} ms with {float(share):.0%} lost'
                    for share, row in rows.items())
        + '. Other load on the machine comes in bursts and can move this percentile more than '
        'the losses do. "Its median" is the median over stretches of 300 steps, which is less '
        'sensitive to bursts.')


def _heuristic(f: Figures) -> str:
    return (
        "The heuristic pilot of Gymnasium's LunarLander flies our `lunar_lander` and "
        "Gymnasium's. Difference of the mean returns, with 95 % interval: "
        + ' and '.join(
            f'{row["difference"]:+.1f} ({row["difference_interval"][0]:+.1f} to '
            f'{row["difference_interval"][1]:+.1f}) with {row["action"]} actions'
            for row in f['heuristic'])
        + '. The column "published" has the returns published by EnvPool.')


def _transfer(f: Figures) -> str:
    low, high = f['difference_interval']
    return (
        'The `lunar_lander` policy of the newest run, or the shipped one if there is no run, '
        "flies unchanged in Gymnasium's LunarLander. Mean return: "
        f'{f["ours"]:.1f} here, {f["gymnasium"]:.1f} there, difference '
        f'{f["difference"]:+.1f} ({low:+.1f} to {high:+.1f}, 95 % interval). '
        '[Learning](learning.md#world-lunar_lander) has this comparison for five training seeds.')


def _stopping(f: Figures) -> str:
    return 'Seconds from Ctrl-C to the end of the last process, by stage of a training.'


def _key_latency(f: Figures) -> str:
    return (
        'Time from a key press in the keyboard pilot to the first state that shows it, in real '
        f'time, where a step takes 20 ms: median {f["median_ms"]:.1f} ms.')


SECTIONS: dict[str, tuple[str, Callable[[Figures], str]]] = {
    'exchange': ('A lock-step exchange', _exchange),
    'budget': ('The budget of a step', _budget),
    'rollouts': ('Roll-outs', _rollouts),
    'fleet': ('Many simulators', _fleet),
    'hosts': ('Two hosts', _hosts),
    'ranks': ('Several learners', _ranks),
    'loss': ('Two hosts that lose packets', _loss),
    'stepping': ('Stepping a world', _stepping),
    'threads': ('Threads in a simulator', _threads),
    'learner': ('The learner', _learner),
    'result of lunar_lander': ('Time to a result', _result),
    'result of rocket': ('Time to a result: the rocket', _rocket_result),
    'heuristic': ("Gymnasium's pilot in our lander", _heuristic),
    'transfer': ("Our policy in Gymnasium's lander", _transfer),
    'recorder': ('Recorders and views', _recorder),
    'stopping': ('Stopping', _stopping),
    'key_latency': ('From key to state', _key_latency),
}
"""Title and text of each part, or of its figures of a world, in the order of the page."""
