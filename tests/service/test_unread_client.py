"""A client that never reads its replies does not stop others, with and without a configuration file."""

from __future__ import annotations

import pytest

from benchmarks import unread_client


@pytest.mark.parametrize("text", unread_client.CONFIGURATIONS, ids=["defaults", "file"])
def test_others_are_served_while_a_client_does_not_read(text):
    assert len(unread_client.measure(text, 1.0)) >= 2  # each request is answered within the client's timeout
