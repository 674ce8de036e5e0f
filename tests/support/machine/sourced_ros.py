# SPDX-License-Identifier: Apache-2.0
"""An imitation of an installed ROS 2, as under /opt/ros, made of the files of the wheels."""
from __future__ import annotations

import os
import shutil
import sys
from importlib.metadata import Distribution
from importlib.metadata import distribution
from importlib.metadata import distributions
from pathlib import Path

NOT_OF_ROS = 'ros-wheels-bootstrapper'
"""Finds the libraries of the wheels; an installed ROS 2 sets LD_LIBRARY_PATH."""
SYSTEM = ('numpy', 'PyYAML', 'packaging', 'typing_extensions', 'lark-parser', 'empy', 'catkin-pkg')
"""What the packages of ROS 2 need of the system's Python."""


def install(prefix: Path, name: str) -> Path:
    """Install ROS 2 below a folder, and return the file to source."""
    for each in distributions():
        package = each.metadata['Name']
        if package.startswith('ros-') and package != NOT_OF_ROS:
            _copy(each, prefix)
    environment = Path(sys.prefix)
    for file in (path for path in prefix.glob('share/**/*') if path.suffix in ('.cmake', '.pc')):
        text = file.read_text()
        if str(environment) in text:
            file.write_text(text.replace(str(environment), str(prefix)))
    packages, = prefix.glob('lib/python3.*/site-packages')
    for package in SYSTEM:
        _copy(distribution(package), prefix)
    for bundled in packages.glob('*.libs/*'):
        shutil.copy(bundled, prefix / 'lib')
    command = prefix / 'bin' / 'ros2'
    command.write_text((environment / 'bin' / 'ros2').read_text().replace(
        f'#!{environment}/bin/python', '#!/usr/bin/env python3'))
    command.chmod(0o755)
    setup = prefix / 'setup.bash'
    setup.write_text(f"""export ROS_VERSION=2 ROS_PYTHON_VERSION=3 ROS_DISTRO={name}
export AMENT_PREFIX_PATH={prefix}
export PATH={prefix}/bin:$PATH
export LD_LIBRARY_PATH={prefix}/lib
export PYTHONPATH={packages}
""")
    return setup


def _copy(of: Distribution, prefix: Path) -> None:
    """Copy the installed files to the same places below another prefix."""
    for file in of.files or ():
        source = Path(os.path.normpath(str(of.locate_file(file))))
        if source.is_relative_to(sys.prefix) and source.suffix != '.pyc' and source.is_file():
            target = prefix / source.relative_to(sys.prefix)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target, follow_symlinks=False)
