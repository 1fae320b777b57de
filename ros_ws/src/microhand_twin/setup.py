# SPDX-License-Identifier: Apache-2.0
"""Installs the physics twin, for pip and for colcon. ROS dependencies are in package.xml."""

from setuptools import find_packages, setup

NAME = 'microhand_twin'

setup(
    name=NAME,
    version='0.1.0',
    description='Physics twin: fingers and object in MuJoCo',
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
    install_requires=['imageio-ffmpeg', 'microhand_planner', 'mujoco', 'numba', 'numpy', 'scipy'],
    entry_points={'console_scripts': ['twin = microhand_twin.ros.twin_node:main']},
    zip_safe=True,
)
