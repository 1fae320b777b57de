# SPDX-License-Identifier: Apache-2.0
"""Installs the stage driver, for pip and for colcon. ROS dependencies are in package.xml."""

from setuptools import find_packages, setup

NAME = 'stage_driver_sim'

setup(
    name=NAME,
    version='0.1.0',
    description='Driver of one piezo stage, simulated or behind a GCS controller',
    license='Apache-2.0',
    maintainer='microhand maintainers',
    maintainer_email='maintainers@microhand.example',
    python_requires='>=3.10',
    packages=find_packages(),
    package_data={NAME: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    install_requires=['numba', 'numpy'],
    entry_points={
        'console_scripts': [
            'gcs_server = stage_driver_sim.gcs.server_command:main',
            'stage_driver = stage_driver_sim.driver_node:main',
        ],
    },
    zip_safe=False,
)
