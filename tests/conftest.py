"""Shared configuration of the tests: the profile of hypothesis, and a running server.

Where a build server runs the suite, hypothesis tries the same examples every time; at a desk it looks for new ones.
"""

import os

import pytest
from hypothesis import settings
from support.servers import ANY_LOCAL_PORT, TIMEOUT, plain_session

from graspforce.service import Client, Server

settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("desk", deadline=None)  # a busy computer is no failure of a law
settings.load_profile("ci" if os.environ.get("CI") else "desk")


@pytest.fixture(scope="module")
def server():
    """Run a server of the four-finger hand for all tests of a module."""
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as running:
        yield running


@pytest.fixture
def client(server):
    with Client(server.addresses[0], timeout=TIMEOUT) as opened:
        yield opened


@pytest.fixture
def raw(server):
    """Open a Zenoh session to the server without graspforce's client."""
    with plain_session(server.addresses[0]) as session:
        yield session
