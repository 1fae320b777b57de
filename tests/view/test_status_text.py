# SPDX-License-Identifier: Apache-2.0
"""What the page says of the station: whole, in words, and nothing that a text could smuggle in."""

import math
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.pose import Pose
from microhand_station.sequencer.progress import Progress
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import State
from microhand_station.view import status_text
from microhand_station.view.snapshot import Contact, Note, Snapshot, Stage, Thing

EVIL = '<img src=x onerror=alert(1)>"\'</div><script>alert(2)</script>'
PRESSES = Contact(True, np.zeros(3), np.array([0.0, 0.0, 4.56]), 4.56, 0.34)
FREE = Contact(False, np.full(3, np.nan), np.zeros(3), 0.0, math.nan)


class Reader(HTMLParser):
    """Reads HTML, and refuses what is not well-formed."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.words = [], set(), []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        """Open an element; only styles may be given."""
        assert {name for name, _ in attrs} <= {'style'}
        self.open.append(tag)
        self.tags.add(tag)

    def handle_endtag(self, tag):
        """Close the element that is open."""
        assert self.open.pop() == tag

    def handle_data(self, data):
        """Keep the text."""
        self.words.append(data)

    @property
    def text(self):
        """All words."""
        return ' '.join(' '.join(self.words).split())


def thing(**changes):
    """Return an object that two fingers hold, turned by 30° about z."""
    turned = Pose.of((1.0, -1e-4, 0.25), Rotation.from_rotvec([0, 0, math.radians(30)]))
    return replace(Thing(turned, True, True, '', (PRESSES, PRESSES, FREE)), **changes)


def stage(**changes):
    """Return a stage that holds."""
    return replace(Stage(Mode.HOLDING, True, '', np.zeros(3), 0.0123), **changes)


@pytest.mark.parametrize('state', list(State))
def test_every_state_has_its_name(state):
    """The badge says what the sequencer does; so it does when there is none."""
    text = Reader(status_text.sequencer_card(Snapshot(state=state), pausing=False)).text
    assert state.name.lower().split('_')[0] in text
    assert 'not there' in Reader(status_text.sequencer_card(Snapshot(), pausing=False)).text


def test_progress_tells_step_share_and_time_left():
    """People count steps from 1."""
    progress = Progress(step=6, steps=34, rotation=1, share=0.414, time_left_s=12.3)
    snapshot = Snapshot(state=State.RUNNING, progress=progress)
    text = Reader(status_text.sequencer_card(snapshot, pausing=True)).text
    for words in ('running', 'step 7 of 34', '41 %', '12 s left', 'pauses at the end'):
        assert words in text


def test_the_object_is_held_lost_resting_or_not_there(sphere_plan):
    """Each case has its word; a loss says why, and errors are in degrees and nanometres."""

    def text_of(snapshot):
        return Reader(status_text.object_card(snapshot)).text

    plan = sphere_plan(40.0)
    held = Snapshot(thing=thing(), off_plan=(math.radians(0.123), 0.0456), plan=plan)
    for words in ('held', 'sphere', '0.12° · 46 nm', 'to the goal 10.00°', '1.00, 0.00, 0.25 µm'):
        assert words in text_of(held)
    lost = text_of(Snapshot(thing=thing(held=False, lost_because='no finger touches it')))
    assert 'lost' in lost
    assert 'no finger touches it' in lost
    assert 'resting' in text_of(Snapshot(thing=thing(released=False)))
    assert 'nobody reports an object' in text_of(Snapshot())


def test_each_finger_has_a_row_with_what_it_does_and_feels():
    """Mode, on target, lag, force and friction used; a silent stage and an error stand out."""
    stages = (stage(), None, stage(mode=Mode.FAULT, error='finger_3: too far'))
    html = status_text.fingers_card(Snapshot(stages=stages, thing=thing()))
    text = Reader(html).text
    for words in (
        '1 holding ✓ 12 nm 4.6 µN 34 %',
        '2 silent',
        '3 fault 12 nm',
        'finger_3: too far',
    ):
        assert words in text
    assert Reader(html).tags >= {'table', 'tr', 'td'}


def test_the_latest_events_come_first():
    """No more of them than fit."""
    notes = [Note(1e9 + i, '/sequencer', 0, f'event {i}.') for i in range(20)]
    text = Reader(status_text.notes_card(notes)).text
    assert text.index('event 19.') < text.index('event 18.')
    assert 'event 2.' not in text


def test_texts_from_elsewhere_are_shown_and_never_obeyed(sphere_plan):
    """Names of objects, reasons and events may contain anything: it stays text."""
    plan = replace(sphere_plan(40.0), object_name=EVIL)
    snapshot = Snapshot(
        state=State.RUNNING,
        progress=Progress(step=1, steps=6, share=0.1, time_left_s=1.0),
        stages=(stage(error=EVIL), stage(), stage()),
        thing=thing(held=False, lost_because=EVIL),
        plan=plan,
        notes=(Note(1e9, EVIL, 300, EVIL),),
    )
    cards = (
        status_text.object_card(snapshot),
        status_text.fingers_card(snapshot),
        status_text.notes_card(snapshot.notes),
        status_text.bad_text(EVIL),
        status_text.good_text(EVIL),
        status_text.quiet_text(EVIL),
    )
    for card in cards:
        read = Reader(card)
        assert not read.tags & {'img', 'script'}
        assert 'onerror=alert(1)' in read.text


def test_a_plan_is_summed_up_in_a_sentence(sphere_plan):
    """Steps, regrasps, cost and distance from the goal."""
    text = Reader(status_text.plan_text(sphere_plan(40.0), 1.26, 1e-16)).text
    for words in ('1.3 s', '6 steps', '2 regrasps', 'cost 448°', '0.00° from the goal'):
        assert words in text
