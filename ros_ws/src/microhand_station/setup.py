# SPDX-License-Identifier: Apache-2.0
"""Installs the station and the ``microhand`` command, for pip and for colcon."""

from glob import glob

from setuptools import find_packages, setup

NAME = 'microhand_station'

setup(
    name=NAME,
    version='0.1.0',
    description='Sequencer, recorder, launch files and command line of a microhand station',
    license='Apache-2.0',
    maintainer='microhand maintainers',
    maintainer_email='maintainers@microhand.example',
    python_requires='>=3.10',
    packages=find_packages(),
    package_data={NAME: ['py.typed', 'analysis/page/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
        (f'share/{NAME}/config', sorted(glob('config/*.yaml'))),
        (f'share/{NAME}/foxglove', sorted(glob('foxglove/*.json'))),
        (f'share/{NAME}/rviz', sorted(glob('rviz/*.rviz'))),
    ],
    install_requires=[
        'click',
        'mcap',
        'mcap-ros2-support',
        'numpy',
        'pyyaml',
        'rich',
        'scipy',
        'trimesh',
        'viser',
        'websockets',
    ],
    entry_points={
        'console_scripts': [
            'microhand = microhand_station.cli.app:main',
            'recorder = microhand_station.recording.recorder_node:main',
            'sequencer = microhand_station.sequencer.node:main',
            'view = microhand_station.view.view_node:main',
        ],
    },
    zip_safe=True,
)
