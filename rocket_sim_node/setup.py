# SPDX-License-Identifier: Apache-2.0
"""Package rocket_sim_node: worlds, client and server, recording, and their nodes."""
from setuptools import find_packages
from setuptools import setup

package_name = 'rocket_sim_node'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['py.typed', 'wire/dds/profiles/*.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
    ],
    install_requires=['setuptools', 'lxml', 'numpy', 'pillow', 'pyarrow', 'pymunk', 'rerun-sdk'],
    zip_safe=False,
    maintainer='Hoverslam maintainers',
    maintainer_email='maintainers@users.noreply.h-seed-fcf8f54c.example',
    description='Vectorised rocket worlds, their lock-step wire over DDS, and the Rerun recorder.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'simulator = rocket_sim_node.nodes.simulator:main',
            'rerun_recorder = rocket_sim_node.nodes.rerun_recorder:main',
        ],
    },
)
