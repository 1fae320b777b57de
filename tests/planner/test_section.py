# SPDX-License-Identifier: Apache-2.0
"""Sections given by formulas: lengths, points and normals against calculus."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipe

from microhand_planner.core.analytic_sections import (
    ellipse_section,
    polygon_section,
    waisted_section,
)
from microhand_planner.core.arc_spline import arc_spline
from microhand_planner.core.errors import BadRequest
from microhand_planner.core.section import XY_PLANE, XZ_PLANE, Plane, Section


@pytest.mark.parametrize('plane', [XY_PLANE, XZ_PLANE])
def test_plane_is_right_handed_and_starts_at_x(plane):
    """U × v is the normal, u is X, and points survive the way into the plane and back."""
    np.testing.assert_array_equal(np.cross(plane.e_u, plane.e_v), plane.normal)
    np.testing.assert_array_equal(plane.e_u, [1.0, 0.0, 0.0])
    points = np.random.default_rng(0).normal(size=(10, 2))
    np.testing.assert_array_equal(plane.to_plane(plane.to_object(points)), points)
    np.testing.assert_array_equal(plane.to_object(points) @ plane.normal, np.zeros(10))


def test_unknown_plane_is_refused():
    """There are two planes, with normals Z and Y."""
    with pytest.raises(ValueError, match="'z' or 'y'"):
        Plane('x')


@given(
    st.floats(0.2, 500.0),
    st.floats(0.05, 1.0),
)
@settings(max_examples=50, deadline=None)
def test_ellipse_perimeter_is_the_elliptic_integral(a_um, ratio):
    """The arcs of an ellipse add up to 4 a E(e), for axis ratios down to 1:20."""
    perimeter_um = 4.0 * a_um * ellipe(1.0 - ratio**2)
    section = ellipse_section(a_um, ratio * a_um, XY_PLANE)
    assert section.perimeter_um == pytest.approx(perimeter_um, rel=1e-6)


def test_ellipse_arcs_stay_on_the_curve():
    """Points between the samples satisfy the equation, and normals are its gradient."""
    section = ellipse_section(16.2, 11.6, XY_PLANE)
    row = np.arange(len(section.arcs))
    points, normals = section.arcs.points(row, np.full(len(row), 0.5))
    level = (points[:, 0] / 16.2) ** 2 + (points[:, 1] / 11.6) ** 2 - 1.0
    gradient = 2.0 * points / np.array([16.2, 11.6]) ** 2
    steepness = np.linalg.norm(gradient, axis=1)
    assert np.abs(level / steepness).max() < 1e-7  # µm
    cross = gradient[:, 0] * normals[:, 1] - gradient[:, 1] * normals[:, 0]
    assert np.abs(cross / steepness).max() < 1e-5  # rad


def test_biarcs_converge_with_the_third_power_of_the_span():
    """Halving the spans of a smooth curve divides its distance from the arcs by 8."""

    def gap_um(spans):
        t = np.arange(spans) * 2.0 * math.pi / spans
        points = np.column_stack([3.0 * np.cos(t), 2.0 * np.sin(t)])
        angle = np.unwrap(np.arctan2(3.0 * np.sin(t), 2.0 * np.cos(t)))
        section = Section(XY_PLANE, *arc_spline(points, angle)[:2])
        row = np.repeat(np.arange(len(section.arcs)), 9)
        on_arcs, _ = section.arcs.points(row, np.tile(np.linspace(0, 1, 9), len(section.arcs)))
        gradient = np.linalg.norm(2.0 * on_arcs / np.array([9.0, 4.0]), axis=1)
        return np.abs(((on_arcs / [3.0, 2.0]) ** 2).sum(axis=1) - 1.0).max() / gradient.min()

    assert gap_um(40) / gap_um(80) == pytest.approx(8.0, rel=0.25)


@pytest.mark.parametrize(
    ('waist_um', 'flare_um', 'convex'), [(29.3, 0.0, True), (30.5, 4.0, True), (16.0, 76.0, False)]
)
def test_waisted_normals_are_at_right_angles_to_finite_differences(waist_um, flare_um, convex):
    """Outward normals of the paper-like outlines stand on the curve, which is convex or not."""
    section = waisted_section(36.5, waist_um, flare_um, XY_PLANE)
    t = 2.0 * math.pi * np.arange(512) / 512 + np.array([[-1e-6], [1e-6]])
    height = (waist_um + flare_um * np.cos(t) ** 2) * np.sin(t)
    slope = np.diff(np.stack([36.5 * np.cos(t), height], axis=-1), axis=0)[0]
    normals = np.column_stack([slope[:, 1], -slope[:, 0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    angle = section.normal_angle_rad[::2]  # every other sample joins two arcs
    np.testing.assert_allclose(
        np.column_stack([np.cos(angle), np.sin(angle)]), normals, rtol=0, atol=1e-8
    )
    assert section.is_convex == convex


def test_square_has_straight_edges_and_sharp_corners():
    """Edges have length and no turn, corners a turn of 90° and no length."""
    corners = np.array([[5.0, 5.0], [-5.0, 5.0], [-5.0, -5.0], [5.0, -5.0]])
    section = polygon_section(corners, XY_PLANE)
    np.testing.assert_allclose(section.arc_length_um, [0, 10, 0, 10, 0, 10, 0, 10], atol=1e-12)
    right = math.pi / 2.0
    np.testing.assert_allclose(section.turn_rad, [right, 0] * 4, atol=1e-12)


def test_section_is_frozen_and_its_arrays_read_only():
    """Nobody can change a section under a plan."""
    section = ellipse_section(2.0, 1.0, XY_PLANE)
    for array in (section.points_um, section.normal_angle_rad, section.turn_rad):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 0.0


@pytest.mark.parametrize(
    ('points', 'angles', 'message'),
    [
        ([[0, 0], [1, 0]], [0.0, 1.0], 'at least 3'),
        ([[0, 0], [1, 0], [0, 1]], [0.0, 1.0], 'do not fit'),
        ([[0, 0], [1, 0], [0, math.nan]], [0.0, 1.0, 2.0], 'NaN'),
        ([[1, 0], [0, 1], [-1, 0]], [0.0, 1.0, 2.0], 'one arc'),
        ([[1, 0], [0, 1], [-1, 0]], [0.0, 9.0, 2.0], 'turns too far'),
        ([[1, 0], [1, 0], [-1, 0]], [0.0, 3.2, 4.0], 'turns too far'),
    ],
)
def test_samples_that_are_no_chain_of_arcs_are_refused(points, angles, message):
    """A section checks itself when it is built."""
    with pytest.raises(ValueError, match=message):
        Section(XY_PLANE, np.array(points, dtype=float), np.array(angles))


@pytest.mark.parametrize('axes', [(0.0, 1.0), (-1.0, 1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_impossible_ellipses_are_bad_requests(axes):
    """Semi-axes are positive numbers."""
    with pytest.raises(BadRequest, match='ellipse_um'):
        ellipse_section(*axes, XY_PLANE)
