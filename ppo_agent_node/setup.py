# SPDX-License-Identifier: Apache-2.0
"""Package ppo_agent_node: pilots, learning, evaluation and their nodes."""
from setuptools import find_packages
from setuptools import setup

package_name = 'ppo_agent_node'

setup(
    name=package_name,
    version='1.0.0',
    python_requires='>=3.11',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['py.typed', 'presets/*/*.yaml', 'policies/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/launch', [
            f'launch/{name}.launch.yaml' for name in ('train', 'land', 'evaluate', 'fly')]),
        ('share/' + package_name + '/launch/parameters', [
            'launch/parameters/agent.yaml', 'launch/parameters/simulator.yaml']),
    ],
    install_requires=[
        'setuptools', 'rocket_sim_node[recording]', 'clarabel', 'matplotlib', 'numpy', 'pillow',
        'pyyaml', 'rich', 'safetensors', 'scipy', 'torch'],
    extras_require={
        'onnx': ['onnxruntime'],  # flies ONNX files; torch is installed, but not imported
        'tensorboard': ['tensorboard'],
        'test': ['pytest'],  # for colcon test
        'export': ['onnx', 'onnxruntime', 'onnxscript'],
    },
    zip_safe=False,
    maintainer='Hoverslam maintainers',
    maintainer_email='maintainers@users.noreply.h-seed-fcf8f54c.example',
    description='Expert pilot, behavioural cloning, PPO, curriculum and evaluation over ROS 2.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'ppo_agent = ppo_agent_node.entry_points:ppo_agent',
            'expert_pilot = ppo_agent_node.entry_points:expert_pilot',
            'keyboard_pilot = ppo_agent_node.entry_points:keyboard_pilot',
            'random_pilot = ppo_agent_node.entry_points:random_pilot',
            'evaluate = ppo_agent_node.entry_points:evaluate',
            'watch = ppo_agent_node.entry_points:watch',
            'action_server = ppo_agent_node.entry_points:action_server',
        ],
    },
)
