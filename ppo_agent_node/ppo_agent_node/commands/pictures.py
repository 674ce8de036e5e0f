# SPDX-License-Identifier: Apache-2.0
"""Command `pictures`: renders the pictures of the documentation, including their flights."""
from __future__ import annotations

import sys
from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from ppo_agent_node.commands import compare
from ppo_agent_node.commands import recorded_flights
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import world_of
from ppo_agent_node.reporting.pictures import standard_views as standard_views_picture
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures import training_curves
from ppo_agent_node.reporting.run_files import Lines
from ppo_agent_node.reporting.run_files import load
from rocket_sim_node import command_line
from rocket_sim_node import worlds
from rocket_sim_node.printable import printable_path
from rocket_sim_node.recording.reader import trajectories
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.render import render
from rocket_sim_node.recording.screenshot import ScreenshotSettings
from rocket_sim_node.recording.screenshot import moment
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.sinks.rerun_program import ViewerError
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.scratch_folder import scratch_folder
from rocket_sim_node.settings import setting
from rocket_sim_node.standard_views.motion import MotionViews

SEED = 20_000_000
"""First seed of evaluations."""
WINDOW = (1600, 968)
TALL = (1600, 1168)
"""Size of the viewer's window, pixels; its bars are cropped."""
FRAME_RATE = 5
"""Frames per second of a film."""
SCENE_PART, SCENE_TOP = 0.6, 30
"""Part of a picture's width that shows the scene, and height of the bar above it, pixels."""
FILM_WIDTH = 480
COMPLETE = ('policy.safetensors', 'cloned.safetensors', 'evaluation.json', 'train.jsonl')
"""Files of a run that has ended."""
Maker = Callable[[Path, Path], Image.Image | list[Image.Image]]
"""Makes a picture, or the frames of a film, of a run's folder; the second folder is scratch."""


def fly_and_record(world: str, path: Path) -> None:
    """Fly a world's built-in policy, and record the flight.

    :raises OSError: when the recording cannot be written.
    """
    simulated = worlds.make(world, 1, SEED)
    spec = simulated.spec
    policies = resources.files('ppo_agent_node') / 'policies'
    pilot = PolicyPilot(Path(str(policies / f'{world}.safetensors')), spec)
    recorder = Recorder(
        RecordingFilter(), [FileSink(path, lambda *note: None)], lambda *note: None,
        settle=touchdown.follow)
    recorder.world(WorldInfo.of(spec))
    recorder.states(1, recorded_flights.fly(simulated, pilot, SEED))
    recorder.close()


def shot(
    recording: Path, at: str, flight: int = -1, size: tuple[int, int] = WINDOW,
) -> Image.Image:
    """Return an image of a flight in a recording, at a time that `screenshot` supports."""
    when = moment(
        ScreenshotSettings(str(recording), at=at, flight=flight), trajectories(recording))
    return render(recording, [when], size=size)[0]


def landing(run: Path, scratch: Path) -> Image.Image:
    """Return an image of a landing during its burn."""
    path = scratch / 'landing.rrd'
    fly_and_record('rocket', path)
    return shot(path, 'burn')


def landing_animation(run: Path, scratch: Path) -> list[Image.Image]:
    """Return a landing as the frames of a film, in real time, the scene alone."""
    path = scratch / 'landing.rrd'
    fly_and_record('rocket', path)
    flown = trajectories(path)[-1]
    count = round((flown.time[-1] - flown.time[0]) * FRAME_RATE) + 1
    times = list(flown.time[0] + np.arange(count) / FRAME_RATE)
    frames = render(path, [*times, *[flown.time[-1]] * FRAME_RATE], size=WINDOW)
    scenes = [frame.crop((0, SCENE_TOP, round(SCENE_PART * frame.width), frame.height))
              for frame in frames]
    size = FILM_WIDTH, round(FILM_WIDTH * scenes[0].height / scenes[0].width)
    return [scene.resize(size, Image.Resampling.LANCZOS) for scene in scenes]


def lunar_lander(run: Path, scratch: Path) -> Image.Image:
    """Return an image of a lander on its pad."""
    path = scratch / 'lunar_lander.rrd'
    fly_and_record('lunar_lander', path)
    return shot(path, 'touchdown')


def comparison(run: Path, scratch: Path) -> Image.Image:
    """Return an image of a run's pilots side by side, when the first of them touches down."""
    path = scratch / 'comparison.rrd'
    compare.make(compare.Comparison(run_dir=str(run), output=str(path)))
    return shot(path, 'touchdown', flight=0, size=TALL)


def standard_views(run: Path, scratch: Path) -> Image.Image:
    """Return an image of a flight as node `ros_bridge` publishes it."""
    world = worlds.make('rocket', 1, SEED, conditions='mix', observation='extended')
    spec = world.spec
    policies = resources.files('ppo_agent_node') / 'policies'
    samples = recorded_flights.fly(
        world, PolicyPilot(Path(str(policies / 'robust.safetensors')), spec), SEED)
    views = MotionViews([0])
    views.world = WorldInfo.of(spec)
    flown = [moment.rockets[0] for moment in views.add(1, samples)]
    with style.styled():
        path = style.save(
            standard_views_picture.views_figure(flown, views.world), scratch / 'views.png')
    return Image.open(path).convert('RGB')


def cloning(run: Path, scratch: Path) -> Image.Image:
    """Return an image of the loss of a run's clone."""
    return _plot(run, 'clone', training_curves.cloning_figure, scratch)


def training(run: Path, scratch: Path) -> Image.Image:
    """Return an image of the learning curves of a run."""
    return _plot(run, 'finetune', training_curves.training_figure, scratch)


def _plot(
    run: Path, stage: str, draw: Callable[[Lines], Figure], scratch: Path,
) -> Image.Image:
    lines = load(run).stage(stage)
    with style.styled():
        path = style.save(draw(lines), scratch / f'{stage}.png')
    return Image.open(path).convert('RGB')


MAKERS: Mapping[str, Maker] = {
    'landing': landing, 'landing_animation': landing_animation, 'lunar_lander': lunar_lander,
    'standard_views': standard_views, 'comparison': comparison, 'cloning': cloning,
    'training': training}


@dataclass(frozen=True)
class Pictures:
    """Arguments of the command."""

    run_dir: str = setting(
        '', '', 'run for cloning, training and comparison; empty: the newest complete one of '
        "'rocket'")
    output: str = setting('docs/images', '', 'folder for the pictures')
    only: str = setting('', '', 'make only this picture', choices=('', *MAKERS))


def newest_run(runs: Path) -> Path:
    """Return the newest finished run of world `rocket`.

    :raises FileNotFoundError: when there is none.
    """
    ended = [
        config.parent for config in runs.glob('*/config.yaml')
        if all((config.parent / name).is_file() for name in COMPLETE)
        and world_of(config) == 'rocket']
    if not ended:
        raise FileNotFoundError(
            2, "run_dir: no finished run of world 'rocket' with a clone; train one, or name one; "
            'looked in', str(runs.resolve()))
    return max(ended, key=lambda run: (run / 'evaluation.json').stat().st_mtime)


def save(made: Image.Image | list[Image.Image], stem: Path) -> Path:
    """Write a picture as PNG, or the frames of a film as an animated GIF; return its path.

    :raises OSError: when it cannot be written.
    """
    if not isinstance(made, list):
        path = stem.with_suffix('.png')
        made.save(path, optimize=True)
        return path
    path = stem.with_suffix('.gif')
    first, *others = [frame.quantize(256, dither=Image.Dither.NONE) for frame in made]
    first.save(
        path, save_all=True, append_images=others, duration=round(1000 / FRAME_RATE), loop=0,
        optimize=True)
    return path


def make(wanted: Pictures) -> str:
    """Make the pictures and print the name of each; return ''.

    :raises FileNotFoundError: when a run is needed and there is none.
    :raises ValueError: when a run or a recording does not fit.
    :raises OSError: when a picture cannot be written.
    :raises ViewerError: when the viewer fails.
    """
    chosen = [wanted.only] if wanted.only else list(MAKERS)
    run = Path(wanted.run_dir)
    if not wanted.run_dir and {'cloning', 'training', 'comparison'} & set(chosen):
        run = newest_run(Path('runs'))
    output = Path(wanted.output)
    output.mkdir(parents=True, exist_ok=True)
    for name in chosen:
        with scratch_folder() as scratch:
            made = MAKERS[name](run, scratch)
        path = save(made, output / name)
        first = made[0] if isinstance(made, list) else made
        sys.stdout.write(f'{printable_path(path)}, {first.width} x {first.height}\n')
        sys.stdout.flush()
    return ''


def main() -> None:
    """Run the command."""
    command_line.run(
        'pictures', '[NAME:=VALUE ...]',
        f'Draws the pictures of the documentation: {", ".join(MAKERS)}.', Pictures, make,
        expected=(ViewerError,), bare=True)


if __name__ == '__main__':
    main()
