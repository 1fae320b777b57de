# SPDX-License-Identifier: Apache-2.0
"""Installs the planner, for pip and for colcon. ROS dependencies are in package.xml."""

from setuptools import find_packages, setup

NAME = 'microhand_planner'

setup(
    name=NAME,
    version='0.1.0',
    description='Plans the reorientation of a micro-object held by three fingers',
    license='Apache-2.0',
    maintainer='microhand maintainers',
    maintainer_email='maintainers@microhand.example',
    python_requires='>=3.10',
    packages=find_packages(),
    package_data={NAME: ['py.typed', 'catalogue/*.stl', 'catalogue/*.json']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    install_requires=['lxml', 'networkx', 'numba', 'numpy', 'ruckig', 'scipy', 'trimesh'],
    entry_points={
        'console_scripts': ['planner_node = microhand_planner.ros.planner_node:main'],
    },
    zip_safe=False,
)
