# SPDX-License-Identifier: Apache-2.0
"""Pictures and films show the run. Needs no ROS, but a library that draws without a screen."""

import ctypes.util
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.errors import RunFailed
from microhand_planner.core.pose import Pose
from microhand_twin import pictures
from microhand_twin.pictures import FRAMES_PER_S, HEIGHT, WIDTH, Camera, Film, write_picture
from microhand_twin.simulation import Simulation
from microhand_twin.world import build_world

draws = pytest.mark.skipif(
    not any(map(ctypes.util.find_library, ('OSMesa', 'EGL'))),
    reason='no library draws without a screen here (Debian, Ubuntu: libosmesa6)',
)


@pytest.fixture
def simulation():
    """Return the convex object between two tips, the third one in sight."""
    made = Simulation(build_world(find_part('convex')))
    made.place(Pose(), [[41.0, 0.0, 0.0], [0.0, 30.0, 40.0], [0.0, -45.0, 20.0]], fixed=True)
    return made


@draws
def test_a_picture_shows_object_and_three_tips(simulation):
    """Cream in the middle, sky in the corners, and something blue, orange and green."""
    with Camera(simulation) as camera:
        image = camera.picture(simulation)
    assert image.shape == (HEIGHT, WIDTH, 3)
    r, g, b = image.astype(int).transpose(2, 0, 1)
    assert np.all(image[HEIGHT // 2, WIDTH // 2, 0] > image[HEIGHT // 2, WIDTH // 2, 2])  # cream
    assert np.all(image[5, 5, 2] >= image[5, 5, 0])  # sky
    blue, orange, green = (b > r + 90), (r > b + 110) & (g > b), (g > r + 60) & (g > b + 30)
    assert all(colour.mean() > 0.001 for colour in (blue, orange, green))


@draws
def test_a_picture_follows_the_simulation(simulation):
    """Turned, the object looks different; a caption changes a corner alone."""
    with Camera(simulation) as camera:
        before = camera.picture(simulation)
        captioned = camera.picture(simulation, 'a caption')
        simulation.place(Pose((0, 0, 0), (0.8, 0.0, 0.0, 0.6)), simulation.tip_um, fixed=True)
        after = camera.picture(simulation)
    assert np.mean(before != after) > 0.05
    rows, columns, _ = np.nonzero(before != captioned)
    assert rows.min() > 0.9 * HEIGHT
    assert columns.max() < 0.4 * WIDTH


def test_a_png_is_read_back_as_it_was_written(tmp_path):
    """Another reader sees the same pixels."""
    image = np.random.default_rng(1).integers(0, 256, size=(48, 64, 3), dtype=np.uint8)
    write_picture(image, tmp_path / 'noise.png')
    command = [imageio_ffmpeg.get_ffmpeg_exe(), '-loglevel', 'error', '-i', 'noise.png']
    command += ['-f', 'rawvideo', '-pix_fmt', 'rgb24', '-']
    read = subprocess.run(command, cwd=tmp_path, capture_output=True, check=True).stdout
    assert np.array_equal(np.frombuffer(read, dtype=np.uint8).reshape(48, 64, 3), image)


def test_a_film_lasts_as_long_as_it_should(tmp_path):
    """As many frames as were added, 25 a second, in the size of the pictures."""
    path = tmp_path / 'film.mp4'
    with Film(path) as film:
        for level in range(50):
            assert film.is_due(level / FRAMES_PER_S + 1e-9)
            assert not film.is_due((level - 0.5) / FRAMES_PER_S)
            film.add(np.full((HEIGHT, WIDTH, 3), 4 * level, dtype=np.uint8))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 50
    assert seconds == pytest.approx(2.0, abs=0.05)


def test_a_machine_that_cannot_draw_says_what_to_install(simulation, monkeypatch):
    """Without a library, one sentence names the package."""
    monkeypatch.setattr(pictures.ctypes.util, 'find_library', lambda name: None)
    with pytest.raises(RunFailed, match='libosmesa6'):
        Camera(simulation)


def test_a_picture_that_cannot_be_written_is_named(tmp_path):
    """A folder that is missing is a failed run, not a traceback."""
    with pytest.raises(RunFailed, match='missing'):
        write_picture(np.zeros((2, 2, 3), dtype=np.uint8), tmp_path / 'missing' / 'a.png')
