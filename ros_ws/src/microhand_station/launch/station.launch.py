# SPDX-License-Identifier: Apache-2.0
"""A simulated station, for launch files that include it: what `microhand station` starts.

The command starts the nodes itself, brings the stage drivers to active and ends all of them, on
every route; launch, which only the apt route has, passes on the arguments and the signals.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start one station; end it with the launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument('namespace', default_value='', description='of all its names'),
            DeclareLaunchArgument(
                'config',
                default_value=PathJoinSubstitution(
                    [FindPackageShare('microhand_station'), 'config', 'station.yaml']
                ),
                description='station file: fingers and their stages, motion, contact, tolerances',
            ),
            DeclareLaunchArgument(
                'run_dir', default_value='runs', description='for logs, records'
            ),
            ExecuteProcess(
                cmd=[
                    ExecutableInPackage('microhand', 'microhand_station'),
                    'station',
                    ['--config=', LaunchConfiguration('config')],
                    ['--namespace=', LaunchConfiguration('namespace')],
                    ['--run-dir=', LaunchConfiguration('run_dir')],
                ],
                output='screen',
                sigterm_timeout='20',  # time to close the record
            ),
        ]
    )
