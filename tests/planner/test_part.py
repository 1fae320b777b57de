# SPDX-License-Identifier: Apache-2.0
"""Parts from mesh files: every format, one solid of plausible size, and clear refusals."""

import contextlib
import io

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from microhand_planner.core.errors import (
    BadRequest,
    InvalidMesh,
    InvalidNumber,
    InvalidParameter,
    UnknownObject,
)
from microhand_planner.core.part import FORMATS, load_part, make_part
from tests.planner.solids import ellipsoid, joined, prism, random_rotation


@pytest.fixture
def box():
    """Return a mesh of 20 x 10 x 5."""
    return trimesh.creation.box(extents=[20.0, 10.0, 5.0])


@pytest.mark.parametrize('suffix', FORMATS)
def test_every_format_gives_the_same_part(suffix, tmp_path, box):
    """A box written by trimesh in each format has the same vertices, faces and hash."""
    path = tmp_path / f'box.{suffix}'
    box.export(path)
    part = load_part(path)
    assert part.name == 'box'
    assert part.sha256 == make_part('other name', box.vertices, box.faces).sha256
    np.testing.assert_allclose(part.extents_um, [20.0, 10.0, 5.0])


def test_hash_tells_shapes_apart_but_not_orders():
    """The hash does not change with the order of vertices and faces; it does with the shape."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    rng = np.random.default_rng(3)
    shuffled = rng.permutation(len(sphere.vertices))
    number = np.argsort(shuffled)
    faces = np.roll(number[sphere.faces], 1, axis=1)[rng.permutation(len(sphere.faces))]
    first = make_part('a', sphere.vertices, sphere.faces)
    assert make_part('b', sphere.vertices[shuffled], faces).sha256 == first.sha256
    assert make_part('c', sphere.vertices * 1.0001, sphere.faces).sha256 != first.sha256


def test_unit_scales_the_part(tmp_path, box):
    """A file in mm is 1000 times larger than one in µm."""
    path = tmp_path / 'box.stl'
    box.apply_scale(0.001)
    box.export(path)
    np.testing.assert_allclose(load_part(path, unit_um=1e3).extents_um, [20.0, 10.0, 5.0])


@pytest.mark.parametrize(('unit_um', 'size'), [(1e6, '2e+07'), (1e-3, '0.02 x 0.01 x 0.005')])
def test_wrong_unit_is_named(unit_um, size, tmp_path, box):
    """A box of 20 m, or of 20 nm, is refused; the message names the unit and what it makes."""
    path = tmp_path / 'box.stl'
    box.export(path)
    with pytest.raises(InvalidMesh, match='unit') as caught:
        load_part(path, unit_um=unit_um)
    assert caught.value.field == 'unit'
    assert size in str(caught.value)


def test_metre_file_keeps_its_area(tmp_path):
    """A sphere of 10 µm in a file in metres is as round as in µm: no absolute tolerance bites."""
    path = tmp_path / 'sphere.stl'
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=10e-6)
    path.write_bytes(trimesh.exchange.stl.export_stl(sphere))
    part = load_part(path, unit_um=1e6)
    assert len(part.faces) == 5120
    radius_um = np.linalg.norm(part.vertices_um, axis=1)
    np.testing.assert_allclose(radius_um, 10.0, rtol=1e-6)


def test_inside_out_mesh_is_turned(box):
    """Inverted winding is repaired: the part equals that of the mesh as it should be."""
    inverted = box.copy()
    inverted.invert()
    as_given = make_part('box', box.vertices, box.faces)
    assert make_part('box', inverted.vertices, inverted.faces).sha256 == as_given.sha256
    mesh = trimesh.Trimesh(as_given.vertices_um, as_given.faces, process=False)
    assert mesh.volume == pytest.approx(1000.0)


def test_cavity_belongs_to_its_solid(box):
    """A closed hole inside is no second body."""
    hole = trimesh.creation.box(extents=[5.0, 5.0, 2.0])
    hole.invert()
    hollow = trimesh.util.concatenate([box, hole])
    part = make_part('hollow', hollow.vertices, hollow.faces)
    volume = trimesh.Trimesh(part.vertices_um, part.faces, process=False).volume
    assert volume == pytest.approx(1000.0 - 50.0)


def test_grid_of_boxes_is_one_part():
    """Faces given as loose triangles are joined by equal vertices."""
    part = make_part('step', *joined(((0, 4), (0, 4), (0, 2)), ((0, 2), (0, 4), (2, 4))))
    volume = trimesh.Trimesh(part.vertices_um, part.faces, process=False).volume
    assert volume == pytest.approx(32.0 + 16.0)


def _twice(box, shift):
    other = box.copy()
    other.apply_translation(shift)
    return trimesh.util.concatenate([box, other])


@pytest.mark.parametrize(
    ('spoil', 'message'),
    [
        (lambda v, f: (v, f[1:]), 'not watertight'),
        (lambda v, f: (v, np.vstack([f[0, ::-1], f[1:]])), 'not watertight'),
        (lambda v, f: (v * [1.0, 1.0, 0.0], f), 'unit'),
        (lambda v, f: (np.where(v > 9.0, np.nan, v), f), 'NaN'),
        (lambda v, f: (v, f + 1), 'missing vertices'),
        (lambda v, f: (v, f[:0]), '0 faces'),
        (lambda v, f: (v, f[:3]), '3 faces'),
    ],
)
def test_spoiled_meshes_are_refused(spoil, message, box):
    """Open, inconsistent, flat, NaN, broken and empty meshes each get a message of their own."""
    with pytest.raises(InvalidMesh, match=message):
        make_part('box', *spoil(np.array(box.vertices), np.array(box.faces)))


def test_two_bodies_are_refused(box):
    """Two boxes side by side are not one object."""
    both = _twice(box, [30.0, 0.0, 0.0])
    with pytest.raises(InvalidMesh, match='2 bodies'):
        make_part('boxes', both.vertices, both.faces)


def test_sheet_without_volume_is_refused():
    """A double-sided sheet, tilted so that its extents are fine, has no volume."""
    corners = np.array([[10.0, 0, 0], [0, 10, 0], [-10, 0, 0], [0, -10, 0]])
    both_sides = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    with pytest.raises(InvalidMesh, match='no volume'):
        make_part('sheet', corners @ random_rotation(1).T, both_sides)


def test_missing_and_foreign_files_are_unknown_objects(tmp_path):
    """No file, a folder, and a format that is not read: all say what is allowed."""
    (tmp_path / 'folder.stl').mkdir()
    for name in ('absent.stl', 'folder.stl', 'part.step', 'nul\0.stl', 'none'):
        with pytest.raises(UnknownObject, match='mesh file'):
            load_part(tmp_path / name)


@pytest.mark.parametrize('unit_um', [0.0, -1.0, np.nan, np.inf])
def test_unit_is_a_positive_number(unit_um, tmp_path):
    """The unit is checked before the file is touched."""
    with pytest.raises((InvalidNumber, InvalidParameter), match='unit'):
        load_part(tmp_path / 'absent.stl', unit_um=unit_um)


def test_unknown_frame_is_refused(box):
    """The frame is one of two words."""
    with pytest.raises(InvalidParameter, match='as_given or principal_axes'):
        make_part('box', box.vertices, box.faces, frame='mine')


def test_principal_frame_does_not_depend_on_the_given_one():
    """However a lopsided solid is turned and shifted, its principal frame is the same."""
    vertices, faces = joined(((0, 20), (0, 6), (0, 4)), ((0, 5), (6, 11), (0, 4)))
    vertices[:, 2] += 0.05 * vertices[:, 0]
    parts = []
    for seed in range(4):
        rotation = random_rotation(seed)
        rotation *= np.linalg.det(rotation)
        moved = vertices @ rotation.T + np.random.default_rng(seed).normal(size=3) * 30.0
        parts.append(make_part('L', moved, faces, frame='principal_axes'))
    for part in parts[1:]:
        np.testing.assert_allclose(
            np.sort(part.vertices_um, axis=0), np.sort(parts[0].vertices_um, axis=0), atol=1e-9
        )


def test_principal_axes_of_an_ellipsoid_are_its_axes():
    """X is the longest axis, Z the shortest, whatever the order in the file."""
    part = ellipsoid((7.0, 16.0, 11.0), 3)
    shift_um = np.array([3.0, 4.0, 5.0])
    moved = make_part('e', part.vertices_um + shift_um, part.faces, frame='principal_axes')
    np.testing.assert_allclose(moved.extents_um, [32.0, 22.0, 14.0], rtol=1e-3)
    np.testing.assert_allclose(moved.vertices_um.mean(axis=0), 0.0, atol=1e-6)


def test_equal_moments_keep_the_given_axes():
    """A solid of revolution about X has no second principal axis: Y stays Y."""
    part = ellipsoid((16.2, 11.6, 11.6), 3)
    principal = make_part('e', part.vertices_um, part.faces, frame='principal_axes')
    np.testing.assert_allclose(principal.vertices_um, part.vertices_um, atol=1e-6)


def test_million_faces():
    """A part of a million faces is read like any other."""
    angle = 2.0 * np.pi * np.arange(260_000) / 260_000
    polygon_um = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    part = make_part('disc', *prism(polygon_um, 5.0))
    assert len(part.faces) == 1_040_000


BOX_STL = trimesh.exchange.stl.export_stl(trimesh.creation.box(extents=[20.0, 10.0, 5.0]))
FILE_SETTINGS = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@given(st.sampled_from(FORMATS), st.binary(max_size=400))
@FILE_SETTINGS
def test_any_bytes_are_a_part_or_a_bad_request(tmp_path, suffix, content):
    """Whatever a file holds, the answer is a part or an error with a message."""
    path = tmp_path / f'noise.{suffix}'
    path.write_bytes(content)
    with pytest.raises(BadRequest):
        load_part(path)


@given(st.data())
@FILE_SETTINGS
def test_damaged_file_is_a_part_or_a_bad_request(tmp_path, data):
    """Flipped bytes and cut ends of a good file never end in another error."""
    content = bytearray(BOX_STL)
    for _ in range(data.draw(st.integers(0, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    path = tmp_path / 'damaged.stl'
    path.write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))]))
    with contextlib.suppress(BadRequest):
        part = load_part(path)
        assert trimesh.Trimesh(part.vertices_um, part.faces, process=False).volume > 0.0


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_any_triangles_are_a_part_or_a_bad_request(data):
    """Random faces on random vertices, NaN and huge values included."""
    number = st.floats(-50.0, 50.0) | st.sampled_from([np.nan, np.inf, 1e300, 0.0])
    vertices = data.draw(st.lists(st.tuples(number, number, number), min_size=1, max_size=8))
    index = st.integers(-1, len(vertices))
    faces = data.draw(st.lists(st.tuples(index, index, index), max_size=16))
    with contextlib.suppress(BadRequest):
        make_part('noise', np.array(vertices), np.array(faces, dtype=np.int64).reshape(-1, 3))


def test_obj_cannot_make_the_reader_open_other_files(tmp_path):
    """A material library that an OBJ names is not read."""
    box = trimesh.creation.box(extents=[20.0, 10.0, 5.0])
    text = io.StringIO(trimesh.exchange.obj.export_obj(box)).read()
    path = tmp_path / 'box.obj'
    path.write_text('mtllib secret.mtl\nusemtl gold\n' + text)
    (tmp_path / 'secret.mtl').mkdir()  # reading it would fail
    assert len(load_part(path).faces) == 12
