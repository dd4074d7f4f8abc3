"""What many tests begin with: hypothesis's profile, and a service that runs.

Where a build server runs the suite, hypothesis tries the same examples every time; at a desk it looks for new ones.
"""

import os

import pytest
from hypothesis import settings
from support.servers import ANY_LOCAL_PORT, PATIENCE, plain_session

from graspforce.service import Client, Server

settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")


@pytest.fixture(scope="module")
def server():
    """One that serves the four-finger hand, for all tests of a file."""
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as running:
        yield running


@pytest.fixture
def client(server):
    with Client(server.addresses[0], timeout=PATIENCE) as opened:
        yield opened


@pytest.fixture
def raw(server):
    """A plain Zenoh session at the server, as another program's would be."""
    with plain_session(server.addresses[0]) as session:
        yield session
