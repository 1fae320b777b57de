# SPDX-License-Identifier: Apache-2.0
"""How the world looks in pictures: nothing here takes part in the physics."""

from __future__ import annotations

TIP_RGBA = ('0.13 0.45 0.80 1', '0.90 0.45 0.10 1', '0.15 0.62 0.35 1')
"""Fingers 1, 2, 3: blue, orange, green."""
FORCE_RGBA = (0.78, 0.10, 0.18, 1.0)

VISUAL_XML = """
  <visual>
    <global azimuth="140" elevation="-28" fovy="30" offwidth="960" offheight="720"/>
    <headlight ambient="0.32 0.32 0.32" diffuse="0.18 0.18 0.18" specular="0.1 0.1 0.1"/>
    <quality shadowsize="2048" offsamples="4" numslices="64" numstacks="48"/>
    <map shadowclip="2" shadowscale="0.8"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.96 0.97 0.98"
             rgb2="0.70 0.76 0.83" width="256" height="256"/>
    <texture name="squares" type="cube" builtin="checker" rgb1="0.93 0.90 0.83"
             rgb2="0.80 0.75 0.64" width="512" height="512"/>
    <material name="object" texture="squares" specular="0.3" shininess="0.4"/>
    <material name="tip1" rgba="{}" specular="0.5" shininess="0.6"/>
    <material name="tip2" rgba="{}" specular="0.5" shininess="0.6"/>
    <material name="tip3" rgba="{}" specular="0.5" shininess="0.6"/>
  </asset>""".format(*TIP_RGBA)

LIGHTS_XML = """
  <light pos="40 -60 90" dir="-0.35 0.52 -0.78" directional="true" diffuse="0.48 0.47 0.45"
         specular="0.2 0.2 0.2" castshadow="true"/>
  <light pos="-60 40 20" dir="0.8 -0.55 -0.25" directional="true" diffuse="0.22 0.24 0.28"
         specular="0 0 0" castshadow="false"/>"""
