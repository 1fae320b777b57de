# SPDX-License-Identifier: Apache-2.0
"""The live view as its user has it: a running station, and a real browser."""

import re
import threading

import numpy as np
import pytest
from microhand_msgs_py.msg import ErrorCode
from playwright.sync_api import expect
from scipy.spatial.transform import Rotation

from microhand_planner.core.pose import Pose
from microhand_station.client import StationClient, StationError
from microhand_station.config import Motion, StationConfig, write_config
from microhand_station.view.address import ViewAddress
from microhand_station.view.page_server import open_page_server
from tests.system.test_station import running

NAME = 'seen'
TOKEN = 'a-secret.of_25~characters'
CONFIG = StationConfig(motion=Motion(travel_um_s=300.0, transit_um_s=400.0, roll_rate_deg_s=10.0))
EARLY_S = 20.0


@pytest.fixture(scope='module')
def station(ros_domain, tmp_path_factory):
    """Start a station with a view on any port."""
    folder = tmp_path_factory.mktemp('seen')
    write_config(CONFIG, folder / 'seen.yaml')
    options = ('--config', str(folder / 'seen.yaml'), '--namespace', NAME, '--view-port', '0')
    with running(folder, *options) as station:
        station.url = station.wait_for_line('view: ').partition('view: ')[2]
        yield station


@pytest.fixture
def client(station):
    """Return a client that is no browser; afterwards the station is idle and in order."""
    with StationClient(NAME) as client:
        yield client
        client.command('reset')


class View:
    """A page of the live view, by what people see of it."""

    def __init__(self, page):
        self.page = page
        self.button('Plan').wait_for()

    def button(self, label):
        """Return a button."""
        return self.page.get_by_role('button', name=label, exact=True)

    def fields(self, label):
        """Return the inputs of a field, the first ones that follow its label."""
        return self.page.locator(f'xpath=//label[text()="{label}"]/following::input')

    def fill(self, label, *values):
        """Fill in a field."""
        for number, value in enumerate(values):
            field = self.fields(label).nth(number)
            field.fill(str(value))
            field.press('Enter')

    def choose(self, label, option):
        """Choose from a list."""
        self.fields(label).first.click()
        self.page.get_by_role('option', name=option, exact=True).click()

    def ask(self, *angles_deg):
        """Ask for a plan, from the origin, and wait for it."""
        self.fields('Put afresh').first.check()
        self.fill('Z Y Z (°)', *angles_deg)
        self.button('Plan').click()
        self.says('Planned in')

    def says(self, text):
        """Wait until a text is there."""
        self.page.get_by_text(text).first.wait_for()

    def is_(self, state):
        """Wait until the sequencer's badge says a word."""
        self.page.get_by_text(state, exact=True).first.wait_for()

    def to_the_goal_deg(self):
        """Return how far the object is said to be from its goal."""
        card = self.page.get_by_text('to the goal').locator('xpath=..').inner_text()
        return float(re.search(r'([\d.]+)°', card)[1])

    def picture(self):
        """Return the scene as it is drawn: panels left and right cut off."""
        clip = {'x': 340, 'y': 200, 'width': 320, 'height': 400}
        return self.page.screenshot(clip=clip)


def goal(*angles_deg):
    """Return the pose turned by ZYZ angles."""
    return Pose.of(np.zeros(3), Rotation.from_euler('ZYZ', angles_deg, degrees=True))


def test_a_request_is_planned_executed_and_watched_and_a_browser_may_leave(
    station, client, open_page
):
    """Plan, execute, see progress and pose change; another browser watches, leaves, no matter."""
    view, other = View(open_page(station.url)), View(open_page(station.url))
    before = view.picture()
    expect(view.button('Execute')).to_be_disabled()
    view.ask(40, 0, 0)
    expect(view.button('Execute')).to_be_enabled()
    expect(other.button('Execute')).to_be_disabled()  # the plan of another is not executed
    view.button('Execute').click()
    for each in (view, other):
        each.is_('running')
        each.says(re.compile(r'step \d+ of \d+'))
    assert view.to_the_goal_deg() > 39.0
    other.page.close()
    view.says('Executed in')
    view.says(re.compile(r'The object is held, 0\.\d\d° off the goal\. Record: .*\.mcap'))
    view.is_('held')
    assert view.to_the_goal_deg() < 1.0
    assert view.picture() != before
    assert view.page.locator('canvas').count() >= 1


def test_a_run_that_others_started_can_be_paused_and_stopped(station, client, open_page):
    """Buttons follow the state; the caller is told that its run was cancelled."""
    view = View(open_page(station.url))
    view.ask(10, 0, 0)  # what is drawn for the first time takes its time without a GPU
    plan = client.plan('ellipsoid', Pose(), goal(90, 60, 0)).plan
    errors = []

    def execute():
        try:
            client.execute(plan)
        except StationError as error:
            errors.append(error)

    run = threading.Thread(target=execute)
    run.start()
    try:
        view.is_('running')
        expect(view.button('Resume')).to_be_disabled()
        view.button('Pause').click()
        view.is_('paused')
        expect(view.button('Pause')).to_be_disabled()
        view.button('Resume').click()
        view.is_('running')
        view.button('Stop').click()
        view.is_('idle')
    finally:
        run.join(EARLY_S)
    assert [error.code for error in errors] == [ErrorCode.CANCELLED]


def test_the_emergency_stop_latches_until_it_is_reset(station, client, open_page):
    """Stages stop and say so, nothing can be executed; after the reset the station is idle."""
    view = View(open_page(station.url))
    view.ask(60, 0, 0)
    view.button('Execute').click()
    view.is_('running')
    view.button('EMERGENCY STOP').click()
    view.is_('emergency stop')
    view.says(re.compile('Execute: the emergency stop was pressed'))
    expect(view.page.locator('table').get_by_text('stopped')).to_have_count(3)
    view.ask(30, 0, 0)  # planning is thinking
    expect(view.button('Execute')).to_be_disabled()
    expect(view.button('EMERGENCY STOP')).to_be_disabled()
    view.button('Reset').click()
    view.is_('idle')
    expect(view.button('Execute')).to_be_enabled()


def test_what_is_wrong_with_a_request_is_said_in_words(station, client, open_page):
    """An object that is no file, no rotation at all, and a goal that stages cannot reach."""
    view = View(open_page(station.url))
    view.choose('Object', 'mesh file …')
    view.fill('File', '/no/such/part.stl')
    view.button('Plan').click()
    view.says('Plan: object is /no/such/part.stl')
    view.choose('Object', 'convex')
    view.choose('Rotation by', 'quaternion')
    view.fill('w', 0)
    view.button('Plan').click()
    view.says('Plan: quaternion is [0.0, 0.0, 0.0, 0.0]; allowed: four finite numbers')
    view.fill('w', 1)
    view.fill('Shift (µm)', 500, 0, 0)
    view.button('Plan').click()
    view.says('Planned in')
    view.button('Execute').click()
    view.says(re.compile(r'Execute: (finger \d x is at|no safe way)'))


def test_a_browser_opens_a_guarded_page_by_its_token(open_page):
    """Without it one sentence; with it the page, from then on without the token."""
    server = open_page_server(ViewAddress('127.0.0.1', 0, TOKEN), 'guarded')
    url = f'http://127.0.0.1:{server.get_port()}/'
    try:
        page = open_page(url)
        expect(page.locator('body')).to_contain_text('a token is needed')
        page.goto(f'{url}?token={TOKEN}')
        page.get_by_text('guarded').wait_for()  # comes by the websocket
        assert page.url == url
    finally:
        server.stop()
