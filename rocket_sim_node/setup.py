# SPDX-License-Identifier: Apache-2.0
"""Package rocket_sim_node: worlds, client and server, recording, and their nodes."""
from setuptools import find_packages
from setuptools import setup

package_name = 'rocket_sim_node'

setup(
    name=package_name,
    version='1.0.0',
    python_requires='>=3.11',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['py.typed', 'wire/dds/profiles/*/*.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/launch', ['launch/simulate.launch.yaml']),
        ('share/' + package_name + '/launch/parameters', ['launch/parameters/simulator.yaml']),
        ('share/' + package_name + '/views', ['views/hoverslam.rviz', 'views/foxglove.json']),
    ],
    install_requires=['setuptools', 'gymnasium>=1.4', 'numpy', 'pillow', 'pymunk'],
    extras_require={
        'bags': ['mcap', 'pyyaml'],
        'foxglove': ['foxglove-sdk'],
        'recording': ['pyarrow', 'rerun-sdk'],
        'ros': ['lxml'],  # beside rclpy and rocket_msgs, which come with ROS 2
        'rsl_rl': ['rsl-rl-lib'],
        'sb3': ['stable-baselines3'],
        'test': ['pytest'],  # for colcon test
        'torchrl': ['torchrl'],
        'video': ['moviepy'],  # for gymnasium.wrappers.RecordVideo
    },
    zip_safe=False,
    maintainer='Hoverslam maintainers',
    maintainer_email='maintainers@users.noreply.h-seed-fcf8f54c.example',
    description='Vectorised rocket worlds, their lock-step wire over DDS, and the Rerun recorder.',
    license='Apache-2.0',
    entry_points={
        # Gymnasium itself has not read this group since 1.0: import rocket_sim_node.gym.
        'gymnasium.envs': ['hoverslam = rocket_sim_node.gym.registration:register'],
        'console_scripts': [
            'simulator = rocket_sim_node.entry_points:simulator',
            'rerun_recorder = rocket_sim_node.entry_points:rerun_recorder',
            'bag_recorder = rocket_sim_node.entry_points:bag_recorder',
            'ros_bridge = rocket_sim_node.entry_points:ros_bridge',
        ],
    },
)
