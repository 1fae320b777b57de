# SPDX-License-Identifier: Apache-2.0
"""Installs what nodes share, for pip and for colcon. ROS dependencies are in package.xml."""

from setuptools import find_packages, setup

NAME = 'microhand_node'

setup(
    name=NAME,
    version='0.1.0',
    description='What the nodes of a station have in common',
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
    zip_safe=False,
)
